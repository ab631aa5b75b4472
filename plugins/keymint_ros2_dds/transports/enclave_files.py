# SPDX-License-Identifier: Apache-2.0
"""Read the files of an installed enclave."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from comarmor.values import replace
from keymint.api import Environment, InstalledEnclave
from keymint.api.transports import installed_file
from keymint.errors import KeymintError, Origin
from keymint.pki import certificates, smime
from keymint_ros2_dds import enclave_layout as layout, subject_names
from keymint_ros2_dds.lowering.name_mapping import DDS_TOPICS
from keymint_ros2_dds.reading import signed_governance, signed_permissions
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import DocumentCriteria, PermissionsDocument

_OF_ARDENT = frozenset(topic.prefix for topics in DDS_TOPICS.values() for topic in topics if topic.prefix)


class SignedDocuments(NamedTuple):
    """The documents of an enclave whose signatures are verified, and the subject name of its identity."""

    permissions: PermissionsDocument
    governance: GovernanceDocument
    subject_name: str


def signed_documents(folder: Path, environment: Environment) -> SignedDocuments:
    """Return the documents of an enclave; the same files are verified and read once in a run.

    Raises:
        KeymintError: a file cannot be read, or a signature is not valid.
    """
    names = layout.PERMISSIONS_P7S, layout.GOVERNANCE_P7S, layout.CERTIFICATE
    authority = installed_file(folder / layout.authority_file(folder, layout.PERMISSIONS_CA))
    permissions, governance, certificate = (installed_file(folder / name) for name in names)
    files = (authority, permissions, governance, certificate)
    key = b"".join(hashlib.sha256(file).digest() for file in files)
    documents = environment.opened.get(key)
    if not isinstance(documents, SignedDocuments):
        verified = [
            smime.verify(signed, authority, at=environment.now, where=Origin(name))
            for name, signed in ((layout.PERMISSIONS_P7S, permissions), (layout.GOVERNANCE_P7S, governance))
        ]
        documents = environment.opened[key] = SignedDocuments(
            signed_permissions.read(verified[0]),
            signed_governance.read(verified[1]),
            subject_name(certificate, Origin(layout.CERTIFICATE)),
        )
    return documents


def unverified_permissions(folder: Path) -> PermissionsDocument:
    """Return the permissions document of an enclave, whoever signed it.

    Raises:
        KeymintError: it cannot be read.
    """
    signed = installed_file(folder / layout.PERMISSIONS_P7S)
    return signed_permissions.read(smime.signed_content(signed, Origin(layout.PERMISSIONS_P7S)))


def crash(permissions: PermissionsDocument) -> str:
    """Return what in a document crashes the process of Cyclone DDS that reads it, or an empty text."""
    found = permissions.crash
    return f"line {found.line}: {found.text} crashes Cyclone DDS" if found else ""


def document_topics(enclave: InstalledEnclave) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return each topic expression of the permissions with its partition expressions, then those of the governance.

    What cannot be read is left out, and reported by the transports; so is ``*``, of which every name is an example.
    """
    found: dict[tuple[str, tuple[str, ...]], None] = {}
    with suppress(KeymintError):
        for criteria in _criteria(unverified_permissions(enclave.folder)):
            found |= {(topic, criteria.partitions or ()): None for topic in criteria.topics}
    with suppress(KeymintError):
        signed = installed_file(enclave.folder / layout.GOVERNANCE_P7S)
        governance = signed_governance.read(smime.signed_content(signed, Origin(layout.GOVERNANCE_P7S)))
        expressions = (rule.expression for each in governance.domain_rules for rule in each.topic_rules)
        found |= {(expression, ()): None for expression in expressions if expression != "*"}
    return tuple(found)


def _criteria(document: PermissionsDocument) -> Iterator[DocumentCriteria]:
    return (criteria for grant in document.grants for rule in grant.rules for criteria in rule.criteria)


def distro_of(paths: Iterable[str], content: Callable[[str], bytes | None]) -> str:
    """Return ``ardent`` if documents have its partitions; see :meth:`keymint.api.BuildType.distro_of`.

    Only Ardent maps the namespace of a name to a partition; see :mod:`keymint_ros2_dds.lowering.name_mapping`.
    """
    for path in paths:
        with suppress(KeymintError):
            found = content(path) if path.endswith(f"/{layout.PERMISSIONS_P7S}") else None
            criteria = _criteria(signed_permissions.read(smime.signed_content(found))) if found else ()
            if any(name.partition("/")[0] in _OF_ARDENT for one in criteria for name in one.partitions or ()):
                return "ardent"
    return ""


@lru_cache(maxsize=16)  # several claims rest on one
def subject_name(certificate: bytes, where: Origin) -> str:
    """Return the subject of an identity as grants name it: in the order of RFC 2253, last RDN first.

    Raises:
        KeymintError: it is not a certificate.
    """
    return subject_names.of_any(certificates.load(certificate, where).subject)


def refuse_unusable_key(enclave: InstalledEnclave) -> None:
    """Refuse an enclave whose private key is encrypted or in a token: participants are given neither password nor PIN.

    Raises:
        KeymintError: that is so.
    """
    if (enclave.folder / layout.KEY_URI).is_file():
        what = f"the private key of {enclave.subject} lies in a token of its robot"
        help_ = "ask implementations that need no key: -i omg -i fastdds-2.9"
        raise KeymintError(f"{what}, so no participant can be started here", help=help_, code="key-in-token")
    if (enclave.folder / layout.KEY).is_file() and b"ENCRYPTED" in installed_file(enclave.folder / layout.KEY):
        message = f"the private key of {enclave.subject} is encrypted, and participants cannot be given the password"
        help_ = "ask implementations that need no key: -i omg -i cyclonedds-0.10 -i fastdds-2.9"
        raise KeymintError(message, help=help_, code="key-encrypted")


def raise_if_unread(error: KeymintError, folder: Path) -> None:
    """Raise the error if Keymint does not read this form of a signed file; return for other errors.

    A vendor may accept such a file, so its decision is not known.

    Args:
        error: error of the reader.
        folder: the enclave's folder.

    Raises:
        KeymintError: with the path of the file.
    """
    diagnostic = error.diagnostics[0]
    if diagnostic.code != smime.UNREAD or diagnostic.where is None:
        return
    place = Origin(str(folder / diagnostic.where.file), diagnostic.where.line)
    message = f"{diagnostic.message}; so it is not known what vendors permit here"
    raise KeymintError.of([replace(diagnostic, message=message, where=place)])
