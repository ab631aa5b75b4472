# SPDX-License-Identifier: Apache-2.0
"""``authority_issuance.xml``: what was decided about the certificates of authorities, beyond the profile's documents.

Keymint writes this file, and nobody else: its owner's decisions stand in ``authorities.xml`` and its defaults.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from comarmor.errors import Origin
from keymint.api import AuthorityIssuance, CertificateSpec, Phase, Rollover
from keymint.api.source_documents import Reader, place, require_new, text
from keymint.errors import known_authority
from keymint_ros import certificate, validity
from keymint_ros.templates import filled

if TYPE_CHECKING:
    from lxml import etree

FILE = "authority_issuance.xml"


def _issuance(root: etree._Element) -> Mapping[str, tuple[AuthorityIssuance, int]]:
    """Return what was decided by authority, each with its line."""
    found: dict[str, tuple[AuthorityIssuance, int]] = {}
    for element in root.iterfind("authority"):
        name = element.get("name", "").strip()
        message = f"there are two elements for the authority {name!r}"
        require_new(name, found, element, message, "remove one of them", "authority-doubled")
        renewed, rollover = element.find("renewed"), element.find("rollover")
        issuance = AuthorityIssuance(
            renewed=None if renewed is None else validity.date(renewed),
            adopted=certificate.pem(element.find("adopted")),
            rollover=None
            if rollover is None
            else Rollover(Phase(rollover.get("phase", "").strip()), certificate.pem(rollover)),
            exposed=text(element.find("exposed")) or "",
        )
        found[name] = issuance, place(element).line
    return MappingProxyType(found)


_read = Reader("keymint_ros", "authority_issuance", _issuance)


def read(files: Mapping[str, bytes], folder: str, known: Collection[str]) -> Mapping[str, AuthorityIssuance]:
    """Return what was decided about authorities, by name.

    Args:
        files: the files of the profile by path relative to the profile space.
        folder: the profile space, as the user would type it.
        known: names of the authorities.

    Raises:
        KeymintError: with ``file:line`` of each defect.
    """
    content = files.get(FILE)
    if content is None:
        return {}
    name = f"{folder}/{FILE}"
    found = _read(content, name)
    for authority, (_, line) in found.items():
        help_ = "restore it in the profile, or remove this element"
        known_authority(authority, known, Origin(name, line), help_=help_)
    return {authority: issuance for authority, (issuance, _) in found.items()}


def applied(spec: CertificateSpec, issuance: AuthorityIssuance) -> CertificateSpec:
    """Return the certificate of an authority after what was decided about it."""
    if not issuance.adopted:
        # The begin stays: certificates that it issued before would otherwise begin before it.
        end = validity.renewed(spec.validity, issuance.renewed).not_after
        return replace(spec, validity=replace(spec.validity, not_after=end))
    from keymint.pki import foreign_authorities  # noqa: PLC0415 - few profiles have one, and it takes time to import

    return foreign_authorities.adopted(spec, issuance.adopted)


def with_authority_issuance(issuance: Mapping[str, AuthorityIssuance]) -> Mapping[str, bytes]:
    """Return the document: see :meth:`keymint.api.AuthorityIssuanceFiles.with_authority_issuance`."""
    lines = (line for name, each in issuance.items() if each != AuthorityIssuance() for line in _lines(name, each))
    return {FILE: filled("decisions/authority_issuance.xml", lines=tuple(lines))}


def _lines(name: str, issuance: AuthorityIssuance) -> Iterator[str]:
    yield f'  <authority name="{name}">'
    if issuance.renewed is not None:
        yield f"    <renewed>{validity.written(issuance.renewed)}Z</renewed>"
    if issuance.adopted:
        yield f"    <adopted>\n{issuance.adopted.decode('ascii').strip()}\n    </adopted>"
    if rollover := issuance.rollover:
        pem = rollover.certificate.decode("ascii").strip()
        yield f'    <rollover phase="{rollover.phase}">\n{pem}\n    </rollover>'
    if issuance.exposed:
        yield f"    <exposed>{issuance.exposed}</exposed>"
    yield "  </authority>"
