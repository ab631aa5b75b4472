# SPDX-License-Identifier: Apache-2.0
"""``keymint_package.xml``: makes a folder a package, and names the documents of its parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from comarmor.xml.reader import line
from keymint_ros.document import Reader, text

if TYPE_CHECKING:
    from lxml import etree

MARKER = "keymint_package.xml"
BUILD_TYPE = "keymint_ros2_dds"


@dataclass(frozen=True, slots=True)
class PackagePart:
    """A part of a package: its permissions, governance or identity.

    Attributes:
        line: line of its element, or of the root if the manifest does not mention the part.
        path: path of its document, relative to the package.
        named: whether the manifest gives the path.
        defaults: path of its defaults, relative to the package or else to the profile.
        issuer: name of the authority that signs it; empty if not given.
    """

    line: int
    path: str
    named: bool
    defaults: str
    issuer: str


@dataclass(frozen=True, slots=True)
class PackageManifest:
    """A package manifest, with the usual paths where it gives none.

    Attributes:
        name: empty if not given; the folder names the package then.
        name_line: line of the name.
        build_type: the plugin that builds the package.
    """

    name: str
    name_line: int
    permissions: PackagePart
    governance: PackagePart
    identities: PackagePart
    build_type: str


def _manifest(root: etree._Element) -> PackageManifest:
    name = root.find("name")
    return PackageManifest(
        name=text(name) or "",
        name_line=line(root if name is None else name),
        permissions=_part(root, "permissions", "permission", "permissions.xml"),
        governance=_part(root, "governances", "governance", "governance.xml"),
        identities=_part(root, "identities", "identity", "identities.xml"),
        build_type=text(root.find("export/build_type")) or BUILD_TYPE,
    )


def _part(root: etree._Element, group: str, item: str, usual: str) -> PackagePart:
    element = root.find(group)
    if element is None:
        return PackagePart(line(root), usual, named=False, defaults=f"package.defaults/{usual}", issuer="")
    path = text(element.find(f"{item}/{item}_path"))
    return PackagePart(
        line=line(element),
        path=path or usual,
        named=path is not None,
        defaults=text(element.find(f"{item}/defaults_path")) or f"package.defaults/{usual}",
        issuer=text(element.find("issuer_name")) or "",
    )


read = Reader("keymint_package", _manifest)
"""Reads a package manifest."""


def is_name_of(given: str, package: str) -> bool:
    """Tell whether a name in a document is the package's full name, its last segment, or empty."""
    return given.removeprefix("/") in {"", package, package.rpartition("/")[2]}
