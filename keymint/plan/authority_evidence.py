"""What speaks against an authority's certificate in the workspace being the one that enclaves may rest on.

Proofs rest on the certificates in ``public/``. The workspace has other evidence of what these should be: the private
key beside each, the record of the keys that were in use, and the profile. Where that contradicts the certificate, or
the file holds more than the one certificate, nothing that rests on it is claimed. Enclaves are no evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cryptography import x509

from comarmor.errors import Diagnostic, Origin
from keymint.api import Package
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.plan import authority_files, key_record
from keymint.plan.authorities import in_order
from keymint.plan.authority_files import AuthorityFiles
from keymint.plan.private_keys import password
from keymint.session import Inputs, Session

Doubts = Mapping[str, tuple[Diagnostic, ...]]
"""What speaks against authorities, by name; those above an authority count for it as well."""


def doubts(session: Session) -> Doubts:
    """Return what speaks against the authorities of a workspace; those without a defect are left out.

    That a certificate is missing is no part of this: then there is nothing to rest on.
    """
    found: dict[str, tuple[Diagnostic, ...]] = {}
    for authority in in_order(session.profile.authorities):
        files = authority_files.look(session, authority, tuple)
        own = () if files.content is None else tuple(_against(session, files, files.content))
        if all_ := (*own, *found.get(authority.certificate.issuer, ())):
            found[authority.name] = all_
    return found


def about(found: Doubts, package: Package) -> tuple[Diagnostic, ...]:
    """Return what speaks against the authorities that the enclave of a package rests on, each once."""
    issuers = (package.identity.issuer, package.permissions.issuer)
    return tuple(dict.fromkeys(each for issuer in issuers for each in found.get(issuer, ())))


def _against(inputs: Inputs, files: AuthorityFiles, content: bytes) -> Iterator[Diagnostic]:
    where = Origin(files.certificate_file)
    try:
        # Vendors differ in what they read of a file with several blocks: Fast DDS trusts each certificate in it.
        certificates.load(content, where)
        certificate = certificates.load_first(content, where)
        public = certificates.public_key(certificate, where)
        authority_files.require_name(files)
        _require_key(inputs, files, certificate)
        authority_files.require_known(files, public)
    except KeymintError as error:
        yield from error.diagnostics


def _require_key(inputs: Inputs, files: AuthorityFiles, certificate: x509.Certificate) -> None:
    """Require that the private key beside a certificate is its own; one that cannot be read here is no evidence.

    Raises:
        KeymintError: it is another one.
    """
    spec = files.authority.certificate
    if files.key is None:
        return
    try:
        secret = password(spec.key, inputs.environment, spec.origin)
        key = keys.from_pem(files.key, secret, Origin(files.key_file)).public_key()
    except KeymintError:
        return
    if not key_record.was_under_way(inputs.state, keys.fingerprint(key)) and certificate == files.certificate:
        authority_files.require_fit(files, key)
