"""``keymint_package.xml``: what makes a folder a package, and where its parts are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint_ros.document import Reader, line, text

if TYPE_CHECKING:
    from lxml import etree

MARKER = "keymint_package.xml"
BUILD_TYPE = "keymint_ros2_dds"


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a package.

    Attributes:
        line: line of its element, or of the root when the manifest does not mention it.
        path: of its document, relative to the package.
        named: the manifest gives the path.
        defaults: path of its defaults, relative to the package or else to the profile.
        issuer: name of the authority that signs it; empty when it is not given.
    """

    line: int
    path: str
    named: bool
    defaults: str
    issuer: str


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a manifest says, with the usual paths where it says nothing.

    Attributes:
        name: empty where it is that of the folder without saying so.
        name_line: its line.
        build_type: the plugin that builds the package.
    """

    name: str
    name_line: int
    permissions: Part
    governance: Part
    identities: Part
    build_type: str


def _manifest(root: etree._Element) -> Manifest:
    name = root.find("name")
    return Manifest(
        name=text(name) or "",
        name_line=line(root if name is None else name),
        permissions=_part(root, "permissions", "permission", "permissions.xml"),
        governance=_part(root, "governances", "governance", "governance.xml"),
        identities=_part(root, "identities", "identity", "identities.xml"),
        build_type=text(root.find("export/build_type")) or BUILD_TYPE,
    )


def _part(root: etree._Element, group: str, item: str, usual: str) -> Part:
    element = root.find(group)
    if element is None:
        return Part(line(root), usual, named=False, defaults=f"package.defaults/{usual}", issuer="")
    path = text(element.find(f"{item}/{item}_path"))
    return Part(
        line=line(element),
        path=path or usual,
        named=path is not None,
        defaults=text(element.find(f"{item}/defaults_path")) or f"package.defaults/{usual}",
        issuer=text(element.find("issuer_name")) or "",
    )


read = Reader("keymint_package", _manifest)
"""Reads a manifest."""


def check_name(manifest: Manifest, name: str, file: str) -> None:
    """Check that a manifest gives the name that the package's folder has, in full or its last segment, or none.

    Raises:
        KeymintError: it gives another one.
    """
    last = name.rpartition("/")[2]
    if manifest.name.removeprefix("/") not in {"", name, last}:
        raise KeymintError(
            f"the package is named {manifest.name!r}, but its folder is that of {name!r}",
            where=Origin(file, manifest.name_line),
            help=f"write <name>{last}</name> or leave it out, or move the folder",
            code="name-mismatch",
        )
