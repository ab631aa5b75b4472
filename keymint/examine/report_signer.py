# SPDX-License-Identifier: Apache-2.0
"""Judge who may sign a report: an authority of its own, whose signatures no robot obeys.

A signature under a report says who made it. By the key of an authority that robots obey, whoever can have reports
signed could try to have them obeyed, and a key that must seldom be used would be used for each report.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from cryptography import x509

from keymint.api import Authority
from keymint.authority import authority_files
from keymint.authority.authorities import authority_named, plan_authorities
from keymint.authority.authority_changes import uses
from keymint.errors import KeymintError
from keymint.life.workspace_register import complete_register, issuer_of
from keymint.pki import certificates
from keymint.pki.examine import KEY
from keymint.workspace.session import Session


def report_signer(session: Session, name: str) -> certificates.Issuer:
    """Return the authority that signs a report, with its private key.

    Args:
        session: the workspace and its profile.
        name: the authority.

    Raises:
        KeymintError: ``report-signer``: robots obey it, or may do so; ``report-signer-missing``: it has no certificate
            yet, or another one than the profile asks for; or its key is not here, or a certificate in a keystore cannot
            be read.
    """
    authority = authority_named(session, name)
    where, certificate = authority.certificate.origin, authority_files.read_files(session, authority).certificate
    if reason := next(_obeyed(session, authority, certificate), None):
        help_ = "name an authority that no package uses, self-signed, e.g. audit_ca: docs/audit.md shows how to add one"
        message = f"the authority {name!r} must not sign reports: {reason}"
        raise KeymintError(message, where=where, help=help_, code="report-signer")
    plan, minted = plan_authorities(session)
    if any(step.package == name and step.writes() for step in plan.steps):
        message = f"the authority {name!r} does not have the certificate that the profile asks for"
        raise KeymintError(message, where=where, help="run 'keymint install'", code="report-signer-missing")
    return minted[name].issuer


def _obeyed(session: Session, authority: Authority, certificate: x509.Certificate | None) -> Iterator[str]:
    """Yield the reasons why robots obey what an authority signs, or may do so."""
    for use in uses(session)[authority.name]:
        yield f"robots obey it, as {use.role} of {use.packages} packages"
    if not session.packages():
        yield "the workspace has no package, so it is not known whose signatures robots obey"
    is_root = certificate is None or certificates.is_issued_by(certificate, certificate)
    if authority.certificate.issuer or authority.certificate.adopted or not is_root:
        yield "another authority stands above it"
    if certificate is None:
        return
    key = certificates.fingerprint(certificate)
    if any(each.issuer == issuer_of(certificate) for each in complete_register(session).certificates.values()):
        yield "it issued certificates of enclaves"
    for path, is_folder in chain(*map(session.tree.walk, (session.workspace.install, session.workspace.next_install))):
        content = b"" if is_folder or path.endswith(f"/{KEY}") else session.tree.read(path) or b""
        found = certificates.load_bundle(content) if certificates.BEGIN in content else ()
        if any(certificates.fingerprint(each) == key for each in found):
            yield f"{session.workspace.shown(path)} has its key, and robots may trust that file"
