# SPDX-License-Identifier: Apache-2.0
"""``issuance.xml``: what an authority decided about the certificate and the grant of a package.

Keymint writes this file, and nobody else: its owner's decisions stand in the other documents of the package.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from comarmor.errors import Origin
from keymint.api import Issuance
from keymint.api.source_documents import Reader, place, text
from keymint.errors import KeymintError
from keymint_ros import certificate, validity
from keymint_ros.manifest import ISSUANCE
from keymint_ros.templates import filled

if TYPE_CHECKING:
    from lxml import etree


def _issuance(root: etree._Element) -> Issuance:
    renewed, public_key = root.find("renewed"), root.find("public_key")
    return Issuance(
        generation=int(text(root.find("generation")) or "0"),
        renewed=None if renewed is None else validity.date(renewed),
        public_key=b"" if public_key is None else _canonical((text(public_key) or "").encode(), place(public_key)),
        certificate=certificate.pem(root.find("certificate")),
        exposed=text(root.find("exposed")) or "",
    )


def _canonical(pem: bytes, where: Origin | None = None) -> bytes:
    from keymint.pki import public_keys  # noqa: PLC0415 - most packages have none, and it takes time to import

    return public_keys.to_pem(public_keys.from_pem(pem, where))


_read = Reader("keymint_ros", "issuance", _issuance)


def issuance(folder: str, files: Mapping[str, bytes]) -> Issuance:
    """Return what the authority decided: see :meth:`keymint.api.IssuanceFiles.issuance`."""
    content = files.get(ISSUANCE)
    return Issuance() if content is None else _read(content, f"{folder}/{ISSUANCE}")


def with_issuance(issued: Issuance) -> Mapping[str, bytes]:
    """Return the document: see :meth:`keymint.api.IssuanceFiles.with_issuance`.

    Raises:
        KeymintError: the generation is negative or has more than nine digits, or the public key is none.
    """
    if not 0 <= issued.generation < _MOST:
        raise KeymintError(f"{issued.generation} is not a generation from 0 to {_MOST - 1}", code="generation-range")
    lines = [f"  <generation>{issued.generation}</generation>"]
    if issued.renewed is not None:
        lines.append(f"  <renewed>{validity.written(issued.renewed)}Z</renewed>")
    if issued.public_key:
        lines.append(f"  <public_key>\n{_canonical(issued.public_key).decode().strip()}\n  </public_key>")
    if issued.certificate:
        lines.append(f"  <certificate>\n{issued.certificate.decode().strip()}\n  </certificate>")
    if issued.exposed:
        lines.append(f"  <exposed>{issued.exposed}</exposed>")
    return {ISSUANCE: filled("decisions/issuance.xml", lines=tuple(lines))}


_MOST = 10**9
