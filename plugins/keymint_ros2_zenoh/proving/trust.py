# SPDX-License-Identifier: Apache-2.0
"""What an enclave rests on: its certificates, and the router's file that the workspace's authority signed.

An enclave cannot vouch for itself, and no session or router looks at the signature. So both are compared with the
authorities of the workspace.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import TrustAnchor, TrustAnchors, ValidityTerm
from keymint.errors import KeymintError
from keymint.pki import certificates, certification_path, distinguished_names, keys, public_keys
from keymint_ros2_zenoh import signature
from keymint_ros2_zenoh.authority_roles import ACCESS, IDENTITY
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, ROUTER, SIGNATURE

_INSTALL = "'keymint install' restores it"


def differences(
    files: Mapping[str, bytes], folder: str, anchors: TrustAnchors, shared: Mapping[str, bytes], shared_folder: str
) -> tuple[Diagnostic, ...]:
    """Return what the workspace's authorities do not vouch for; see :meth:`keymint.api.Prover.differences`."""
    identity, access = anchors.authorities[IDENTITY], anchors.authorities[ACCESS]
    if missing := tuple(_missing((identity, access))):
        return missing
    found = [*_identity(files, folder, anchors), *router_differences(shared, shared_folder, access)]
    return tuple(found)


def router_differences(shared: Mapping[str, bytes], shared_folder: str, access: TrustAnchor) -> tuple[Diagnostic, ...]:
    """Return why the router's file is not what the authority that signs the rights signed.

    Args:
        shared: installed shared files by path.
        shared_folder: the folder of these paths, as the user would type it.
        access: the authority.
    """
    absent = [name for name in (ROUTER, SIGNATURE) if name not in shared]
    if absent:
        return tuple(_error("file-missing", f"{shared_folder}/{name}", "is missing") for name in absent)
    problem = _signature_problem(shared[ROUTER], shared[SIGNATURE], access.chain)
    if not problem:
        return ()
    help_ = "find out who wrote it before 'keymint install' signs the file that the sources build"
    return (_error("zenoh-signature", f"{shared_folder}/{SIGNATURE}", problem, help_),)


# All enclaves rest on the same file.
@lru_cache(maxsize=16)
def _signature_problem(content: bytes, signed: bytes, authority: bytes) -> str:
    return signature.problem(content, signed, certificates.load_first(authority, with_lists=True))


def missing(files: Mapping[str, bytes], folder: str, name: str) -> Diagnostic | None:
    """Return an error if an enclave lacks a file."""
    return None if name in files else _error("file-missing", f"{folder}/{name}", "is missing")


def terms(
    files: Mapping[str, bytes],
    folder: str,
    anchors: TrustAnchors,
    shared: Mapping[str, bytes],
    shared_folder: str,
) -> tuple[ValidityTerm, ...]:
    """Return the periods of the certificates of an enclave; see :meth:`keymint.api.Prover.terms`.

    Rights have no dates: they end with the certificate.

    Raises:
        KeymintError: a file is missing, or is no certificate.
    """
    del anchors, shared, shared_folder
    return tuple(_terms(files, folder))


def _terms(files: Mapping[str, bytes], folder: str) -> Iterator[ValidityTerm]:
    for name, code in ((CERTIFICATE, "certificate"), (IDENTITY_CA, "authority")):
        if absent := missing(files, folder, name):
            raise KeymintError.of([absent])
        where = Origin(f"{folder}/{name}")
        for certificate in certificates.load_bundle(files[name], where):
            period = certificate.not_valid_before_utc, certificate.not_valid_after_utc
            shown = distinguished_names.to_text(certificate.subject)
            yield ValidityTerm(code, f"the certificate of {shown!r}", where, (period,))


def _missing(anchors: tuple[TrustAnchor, ...]) -> Iterator[Diagnostic]:
    for anchor in dict.fromkeys(anchors):
        if not anchor.chain:
            message = f"the certificate of the authority {anchor.name!r} is missing, so nothing can be compared with it"
            help_ = "restore it from a backup of the workspace; the copy in the enclave proves nothing"
            yield _error("authority-missing", anchor.file, message, help_)
            continue
        try:
            certificates.load_bundle(anchor.chain, Origin(anchor.file))
        except KeymintError as error:
            yield from error.diagnostics


def _identity(files: Mapping[str, bytes], folder: str, anchors: TrustAnchors) -> Iterator[Diagnostic]:
    """Yield what is wrong with the certificate, the key and the authority in an enclave."""
    needed = (CERTIFICATE, IDENTITY_CA) if anchors.public_key else (CERTIFICATE, KEY, IDENTITY_CA)
    absent = [name for name in needed if name not in files]
    if absent:
        yield from (_error("file-missing", f"{folder}/{name}", "is missing") for name in absent)
        return
    issuer = anchors.authorities[IDENTITY]
    if files[IDENTITY_CA] != issuer.chain:
        message = f"is not the certificate of the workspace's authority {issuer.name!r}, {issuer.file}"
        help_ = "the enclave trusts another authority: find out who wrote it before 'keymint install' restores it"
        yield _error("authority-differs", f"{folder}/{IDENTITY_CA}", message, help_)
    file = f"{folder}/{CERTIFICATE}"
    where = Origin(file)
    try:
        certificate = certificates.load(files[CERTIFICATE], where)
        expected = distinguished_names.parse(anchors.subject_name)
    except KeymintError as error:
        yield from error.diagnostics
        return
    chain = certification_path.verify_chain(files[CERTIFICATE], issuer.chain, None, where)
    yield from (replace(each, where=each.where or where) for each in chain)
    if certificate.subject != expected:
        shown = distinguished_names.to_text
        message = f"is for {shown(certificate.subject)!r}, not {shown(expected)!r}"
        yield _error("certificate-subject", file, message)
    if anchors.public_key and not public_keys.is_of(anchors.public_key, certificate):
        yield _error("key-mismatch", file, "is for another public key than the package has")
    if KEY not in files:
        return
    try:
        key = keys.from_pem(files[KEY], None, Origin(f"{folder}/{KEY}"))
        if not keys.matches(key, certificate):
            yield _error("key-mismatch", f"{folder}/{KEY}", "is not the key of the certificate beside it")
    except KeymintError as error:
        # An encrypted key cannot be read without its password.
        yield from (each for each in error.diagnostics if each.code != "key-password")


def _error(code: str, file: str, message: str, help_: str = _INSTALL) -> Diagnostic:
    return Diagnostic(code, Severity.ERROR, message, Origin(file), help_)
