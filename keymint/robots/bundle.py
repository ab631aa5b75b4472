# SPDX-License-Identifier: Apache-2.0
"""Bundles: the files of one enclave with a manifest that the issuer of its certificate signs.

The signature is detached CMS (RFC 5652) with the authority's own certificate, as in the documents of enclaves;
``openssl cms -verify`` checks it. Reading a bundle shows that it is whole and by the authority that it names; whether
this authority is the right one is decided in :mod:`keymint.robots.bundle_acceptance`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import field, replace

from cryptography import x509

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.errors import KeymintError
from keymint.pki import certificates, cms
from keymint.pki.revocation_lists import is_by, parse
from keymint.robots import bundle_container
from keymint.robots.bundle_manifest import Manifest, dump, load

CERTIFICATE, KEY = "cert.pem", "key.pem"
"""The identity of an enclave and its private key; see :class:`keymint.api.BuildType`."""
MANIFEST, SIGNATURE = "manifest.json", "manifest.cms"
"""Members of a bundle beside the enclave's files."""
_LIST = b"-----BEGIN X509 CRL-----"
_CERTIFICATE = b"-----BEGIN CERTIFICATE-----"


@dataclass(frozen=True, slots=True)
class Bundle:
    """A bundle that is whole, and signed by the authority that it names.

    Attributes:
        manifest: its manifest.
        encoded: the bytes of the manifest.
        files: the files of the enclave by name.
        certificate: the certificate of the enclave.
        signer: the certificate of the authority that issued it and signed the manifest.
        authorities: the certificates of authorities by file.
        lists: the revocation lists.
    """

    manifest: Manifest
    encoded: bytes
    files: Mapping[str, bytes] = field(repr=False)
    certificate: x509.Certificate
    signer: x509.Certificate
    authorities: Mapping[str, tuple[x509.Certificate, ...]]
    lists: tuple[x509.CertificateRevocationList, ...]


def write(manifest: Manifest, files: Mapping[str, bytes], issuer: certificates.Issuer) -> bytes:
    """Return the bundle of an enclave.

    Args:
        manifest: its manifest; the digests of the files are filled in.
        files: the enclave's files by name; the certificate is by the issuer.
        issuer: the authority.

    Raises:
        KeymintError: the authority's certificate does not permit it to sign documents, or the files are too large.
    """
    if problem := certificates.can_sign_documents(issuer.certificate):
        raise KeymintError.of([replace(problem, help=f"{problem.help}, then 'keymint authority renew' reissues it")])
    encoded = dump(replace(manifest, files={name: _digest(content) for name, content in sorted(files.items())}))
    members = {**files, MANIFEST: encoded, SIGNATURE: cms.sign(encoded, issuer.certificate, issuer.key)}
    try:
        return bundle_container.pack(members)
    except ValueError:
        raise KeymintError(
            f"the files of {manifest.enclave} do not fit into a bundle",
            help=f"the most are {bundle_container.MAX_MEMBERS} files and {bundle_container.MAX_BYTES:,} bytes",
            code="bundle-size",
        ) from None


def read(content: bytes, where: Origin) -> Bundle:
    """Return a bundle, after verifying its digests and its signature.

    Args:
        content: the file.
        where: the file, for messages.

    Raises:
        KeymintError: ``bundle-form``, ``bundle-manifest``, ``bundle-version``: it is not a bundle, or cannot be read.
            ``bundle-altered``: a file or the manifest was altered, or is by another authority than the certificate.
    """
    members = dict(bundle_container.unpack(content, where))
    encoded, signature = members.pop(MANIFEST, b""), members.pop(SIGNATURE, b"")
    manifest = load(encoded, where)
    if {name: _digest(data) for name, data in members.items()} != manifest.files:
        raise _altered("has files that are not those of its manifest", where)
    authorities = certificates_of_authorities(members)
    try:
        certificate = certificates.load(members.get(CERTIFICATE, b""))
        key = certificates.fingerprint(certificate)
        parsed = cms.parse(signature)
        signer = next(
            each
            for chain in authorities.values()
            for each in chain
            if certificates.fingerprint(each) == manifest.authority and certificates.is_issued_by(certificate, each)
        )
        verified = cms.verify(parsed, encoded, signer) and certificates.can_sign_documents(signer) is None
        lists = revocation_lists(members)
    except (KeymintError, StopIteration, ValueError, TypeError):
        raise _altered("is not signed by the authority that issued its certificate", where) from None
    if not verified:
        raise _altered("its manifest is not signed by the authority that issued its certificate", where)
    if key != manifest.key:
        raise _altered("its certificate is for another key than its manifest", where)
    return Bundle(manifest, encoded, members, certificate, signer, authorities, lists)


def certificates_of_authorities(files: Mapping[str, bytes]) -> dict[str, tuple[x509.Certificate, ...]]:
    """Return the certificates that an enclave trusts, by the name of their file.

    Raises:
        KeymintError: a certificate is damaged.
    """
    return {
        name: certificates.load_bundle(content)
        for name, content in files.items()
        if name != CERTIFICATE and _CERTIFICATE in content and name.endswith(".pem")
    }


def issuing_files(certificate: bytes, authorities: Mapping[str, tuple[x509.Certificate, ...]]) -> frozenset[str]:
    """Return the names of the files with the authority that issued the certificate of an enclave, PEM.

    Args:
        certificate: the certificate, PEM; if it cannot be read, nobody issued it.
        authorities: the certificates of authorities by file.
    """
    try:
        own = certificates.load(certificate)
    except KeymintError:
        return frozenset()
    by_file = authorities.items()
    return frozenset(file for file, chain in by_file if any(certificates.is_issued_by(own, each) for each in chain))


def revocation_lists(files: Mapping[str, bytes]) -> tuple[x509.CertificateRevocationList, ...]:
    """Return the revocation lists of an enclave.

    Raises:
        ValueError: a list is damaged.
    """
    blocks = (block for name, content in files.items() if name.endswith(".pem") for block in content.split(_LIST)[1:])
    return tuple(parse(_LIST + block) for block in blocks)


def number_of(lists: Iterable[x509.CertificateRevocationList], authority: x509.Certificate) -> int:
    """Return the lowest number of the revocation lists of an authority (RFC 5280, 5.2.3); 0 if there is none."""
    return min((_number(each) for each in lists if is_by(each, authority)), default=0)


def _number(listed: x509.CertificateRevocationList) -> int:
    try:
        return listed.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number
    except (x509.ExtensionNotFound, ValueError):
        return 0


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _altered(message: str, where: Origin) -> KeymintError:
    help_ = "somebody or something altered it on its way: copy it again from the authority"
    return KeymintError(message, where=where, help=help_, code="bundle-altered")
