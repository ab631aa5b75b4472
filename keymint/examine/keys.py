# SPDX-License-Identifier: Apache-2.0
"""Judge the private keys: where those of authorities are, whether they are stored as asked, and who could read them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from comarmor.errors import Diagnostic
from keymint.authority.authority_files import authority_keys, other
from keymint.errors import KeymintError
from keymint.life.package_issuance import place_of
from keymint.names import subject_of
from keymint.pki import certificates, keys
from keymint.workspace.installed_enclaves import installed_certificate
from keymint.workspace.session import Session


def elsewhere(session: Session) -> Iterator[Diagnostic]:
    """Yield a note for each authority whose private key is not here, which may be meant so."""
    for authority in session.profile.authorities:
        workspace, name = session.workspace, authority.name
        certificate, key = workspace.authority_certificate(name), workspace.authority_key(name)
        is_known = session.tree.has_file(key) or session.tree.is_left_out(key)
        if authority.certificate.key.uri or is_known or not session.tree.has_file(certificate):
            continue
        message = f"the private key of {name!r} is not here"
        help_ = "restore it to sign anything"
        yield Diagnostic.note("authority-key-missing", message, workspace.origin(certificate), help_)


def encryption(session: Session) -> Iterator[Diagnostic]:
    """Yield a warning for each private key of an authority that is stored plain, although the profile asks otherwise.

    The PEM says whether a key is encrypted (:func:`keymint.pki.keys.is_encrypted`), so no password is needed.
    """
    for authority in session.profile.authorities:
        if not authority.certificate.key.password_env:
            continue
        for name in filter(None, (authority.name, other(authority))):
            path = session.workspace.authority_key(name)
            pem = session.tree.try_read(path)
            if pem is not None and not keys.is_encrypted(pem):
                message = f"is not encrypted, although {authority.certificate.origin} asks for that"
                help_ = f"'keymint authority encrypt {authority.name}' encrypts it; backups still hold the plain key"
                yield Diagnostic.warning("key-plain", message, session.workspace.origin(path), help_)


def exposed(session: Session) -> Iterator[Diagnostic]:
    """Yield a warning for each private key in use that others could read before it was taken over.

    The sources remember its fingerprint. A new key has another one, which ends the finding.
    """
    workspace, trusted = session.workspace, authority_keys(session)
    found = []
    for each in session.profile.authorities:
        if each.issuance.exposed in trusted:
            where, verb = workspace.origin(workspace.authority_key(each.name)), f"authority replace {each.name}"
            found.append((f"the authority {each.name!r}", where, verb, ""))
    for name in session.packages():
        with suppress(KeymintError):  # reported with the package
            fingerprint = session.issuance(name).exposed
            certificate = installed_certificate(session, name) if fingerprint else None
            if certificate and fingerprint == certificates.fingerprint(certificate):
                subject = subject_of(name)
                found.append((subject, place_of(session, name), f"renew --rekey {name}", subject))
    for whose, where, verb, subject in found:
        message = f"others could read the private key of {whose} before it was taken over: it counts as exposed"
        yield Diagnostic.warning("key-was-exposed", message, where, f"'keymint {verb}' ends it", subject)
