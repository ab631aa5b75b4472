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
from keymint.plan import authority_places, known_keys
from keymint.plan.authorities import in_order
from keymint.plan.authority_places import Place
from keymint.plan.secrets import password
from keymint.session import Inputs, Session

Doubts = Mapping[str, tuple[Diagnostic, ...]]
"""What speaks against authorities, by name; those above an authority count for it as well."""


def doubts(session: Session) -> Doubts:
    """Return what speaks against the authorities of a workspace; those without a defect are left out.

    That a certificate is missing is no part of this: then there is nothing to rest on.
    """
    found: dict[str, tuple[Diagnostic, ...]] = {}
    for authority in in_order(session.profile.authorities):
        place = authority_places.look(session, authority, tuple)
        own = () if place.content is None else tuple(_against(session, place, place.content))
        if all_ := (*own, *found.get(authority.certificate.issuer, ())):
            found[authority.name] = all_
    return found


def about(found: Doubts, package: Package) -> tuple[Diagnostic, ...]:
    """Return what speaks against the authorities that the enclave of a package rests on, each once."""
    issuers = (package.identity.issuer, package.permissions.issuer)
    return tuple(dict.fromkeys(each for issuer in issuers for each in found.get(issuer, ())))


def _against(inputs: Inputs, place: Place, content: bytes) -> Iterator[Diagnostic]:
    where = Origin(place.certificate_file)
    try:
        # Vendors differ in what they read of a file with several blocks: Fast DDS trusts each certificate in it.
        certificates.load(content, where)
        certificate = certificates.load_first(content, where)
        public = certificates.public_key(certificate, where)
        authority_places.require_name(place)
        _require_key(inputs, place, certificate)
        authority_places.require_known(place, public)
    except KeymintError as error:
        yield from error.diagnostics


def _require_key(inputs: Inputs, place: Place, certificate: x509.Certificate) -> None:
    """Require that the private key beside a certificate is its own; one that cannot be read here is no evidence.

    Raises:
        KeymintError: it is another one.
    """
    spec = place.authority.certificate
    if place.key is None:
        return
    try:
        secret = password(spec.key, inputs.environment, spec.origin)
        key = keys.from_pem(place.key, secret, Origin(place.key_file)).public_key()
    except KeymintError:
        return
    if not known_keys.was_under_way(inputs.state, keys.fingerprint(key)) and certificate == place.certificate:
        authority_places.require_fit(place, key)
