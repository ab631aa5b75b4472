# SPDX-License-Identifier: Apache-2.0
"""The authorities that the enclaves of a keystore trust, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from cryptography import x509

from comarmor.errors import Diagnostic
from keymint.api import FoundAuthority
from keymint.errors import KeymintError
from keymint.pki import certificates, extensions, foreign_authorities, key_files, keys
from keymint.pki.distinguished_names import to_text
from keymint_ros2_dds.authority_roles import IDENTITY, PERMISSIONS
from keymint_ros2_dds.enclave_layout import CA
from keymint_ros2_dds.examine import AUTHORITY_FILES
from keymint_ros2_dds.keystores.enclave_places import EnclavePlace
from keymint_ros2_dds.keystores.file_contents import Contents
from keymint_ros2_dds.keystores.found_enclaves import dates_of, exposure, is_exposed

_NAMES = {IDENTITY: "identity_ca", PERMISSIONS: "permissions_ca"}
BOTH = "ca"
"""Name of an authority that has both roles."""


def authorities(
    contents: Contents, enclaves: Iterable[EnclavePlace]
) -> tuple[tuple[FoundAuthority, ...], list[Diagnostic]]:
    """Return the authorities that the first enclaves trust, and the findings on them.

    The other enclaves are compared with them (:meth:`keymint_ros2_dds.examine.EnclaveRules.trust`).

    Args:
        contents: what the files of the keystore contain.
        enclaves: where the files of its enclaves are.
    """
    findings: list[Diagnostic] = []
    trusted: dict[str, str] = {}
    for role, name in AUTHORITY_FILES.items():
        for enclave in enclaves:
            if path := enclave.files.get(name) or enclave.files.get(CA):
                trusted.setdefault(role, path)
    by_content: dict[bytes, list[str]] = {}
    for role, path in trusted.items():
        by_content.setdefault(contents.read(path), []).append(role)
    found = []
    for roles in map(tuple, by_content.values()):
        path = trusted[roles[0]]
        authority, own = _authority(contents, path, roles)
        found += [authority] if authority else []
        findings += own
    if len({each.facts["fingerprint"] for each in found}) < len(found):
        message = "both authorities have one and the same key"
        help_ = "make a certificate for one of them alone the file of both"
        findings.append(contents.error("adopt-authority-key", found[0].file, message, help_))
    return tuple(found), findings


def _authority(contents: Contents, path: str, roles: tuple[str, ...]) -> tuple[FoundAuthority | None, list[Diagnostic]]:
    content, where = contents.read(path), contents.place(path)
    findings: list[Diagnostic] = []
    try:
        certificate = foreign_authorities.require_authority(content, where)
    except KeymintError as error:
        return None, list(error.diagnostics)
    if content != certificates.to_pem(certificate):
        message = "has text around its certificate, or encodes it in another way; enclaves would get another file"
        help_ = f"rewrite it, here and on the robots: openssl x509 -in {where} -out {where}"
        findings.append(contents.error("adopt-encoding", path, message, help_))
    if not certificates.is_issued_by(certificate, certificate):
        message = f"was issued by {to_text(certificate.issuer)!r}, and not by itself"
        help_ = "Keymint takes over self-signed authorities only; Cyclone DDS refuses others as well"
        findings.append(contents.error("adopt-intermediate", path, message, help_))
    name, end = BOTH if len(roles) > 1 else _NAMES[roles[0]], certificate.not_valid_after_utc
    if end < contents.keystore.now:
        message = f"expired on {end:%Y-%m-%d}: no participant starts"
        help_ = f"'keymint authority renew {name}' afterwards"
        findings.append(contents.warning("adopt-authority-expired", path, message, help_))
    key_paths = contents.keys_of(certificate)
    findings += _about_key(contents, key_paths, name, path)
    findings += _lacking(certificate, roles, path, name, contents)
    public = certificates.public_key(certificate)
    kind = keys.kind_of(public)
    facts: dict[str, Any] = {
        "subject_name": to_text(certificate.subject),
        "fingerprint": keys.fingerprint(public),
        "key_kind": f"RSA {kind.size}" if kind.algorithm == "rsa" else kind.curve,
        **dates_of(certificate),
        "key_usage": extensions.usages(certificate),
        "subject_key_identifier": extensions.value(certificate, x509.SubjectKeyIdentifier) is not None,
        "authority_key_identifier": extensions.value(certificate, x509.AuthorityKeyIdentifier) is not None,
        "path_length": getattr(extensions.value(certificate, x509.BasicConstraints), "path_length", None),
        "key_file": str(contents.place(key_paths[0])) if key_paths else None,
    }
    key = key_files.pem_of(contents.read(key_paths[0]), public) if key_paths else b""
    exposed = any(is_exposed(contents, each) for each in key_paths)
    return FoundAuthority(name, roles, content, path, key, tuple(key_paths), facts, exposed), findings


def _about_key(contents: Contents, key_paths: Sequence[str], name: str, path: str) -> Iterator[Diagnostic]:
    for each in key_paths:
        yield from exposure(contents, each, "")
    if key_paths:
        return
    message = f"has no private key here: the authority {name!r} is taken over without it, and signs nothing here"
    help_ = f"'keymint authority import {name} {contents.place(path)} --key FILE' brings it later"
    if contents.sealed:
        names = ", ".join(str(contents.place(each)) for each in contents.sealed)
        help_ = f"if it is one of {names}, which are encrypted or containers: decrypt it (openssl pkey), then {help_}"
    yield contents.note("adopt-authority-elsewhere", path, message, help_)


def _lacking(
    certificate: x509.Certificate, roles: Sequence[str], path: str, name: str, contents: Contents
) -> Iterator[Diagnostic]:
    """Yield a note for what the certificate lacks, or has too much of; each is the matter of a later step."""
    if len(roles) > 1:
        message = (
            "issues identities and signs permissions: on old vendors, any identity can sign permissions for itself"
        )
        help_ = "CVE-2023-24010; 'keymint harden authority' makes a second one afterwards"
        yield contents.note("adopt-one-authority", path, message, help_)
    lacks = ", and ".join(each.message for each in foreign_authorities.defects(certificate, name, contents.place(path)))
    if lacks:
        help_ = "'keymint harden identifiers' adds it afterwards"
        yield contents.note("adopt-extensions", path, lacks, help_)
