# SPDX-License-Identifier: Apache-2.0
"""``keymint_package.xml``: makes a folder a package, and names the documents of its parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from comarmor.values import dataclass
from comarmor.xml.reader import line
from keymint.api import Role
from keymint.errors import KeymintError
from keymint.source_documents import Reader, place, require_new, text

if TYPE_CHECKING:
    from lxml import etree

MARKER = "keymint_package.xml"
ISSUANCE = "issuance.xml"
"""What an authority decided about the certificate of the package; see :mod:`keymint_ros.issuance`."""
BUILD_TYPE = "keymint_ros2_dds"
SIGNER = "permissions_ca"
"""Name of the authority that signs documents, where one alone does."""


@dataclass(frozen=True, slots=True)
class PackagePart:
    """A part of a package: its permissions, its identity, or one that a build type reads.

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
        line: line of the root.
        parts: the parts of build types that it mentions, by name.
        build_types: the plugins that build the package.
        role: why the package exists.
    """

    name: str
    name_line: int
    line: int
    permissions: PackagePart
    identities: PackagePart
    parts: Mapping[str, PackagePart]
    build_types: tuple[str, ...]
    role: Role

    def part(self, name: str) -> PackagePart:
        """Return a part that a build type reads, with the usual paths if the manifest does not mention it."""
        return self.parts.get(name) or _unmentioned(self.line, f"{name}.xml")


def _manifest(root: etree._Element) -> PackageManifest:
    name = root.find("name")
    return PackageManifest(
        name=text(name) or "",
        name_line=line(root if name is None else name),
        line=line(root),
        permissions=_group(root, "permissions", "permission", "permissions.xml"),
        identities=_group(root, "identities", "identity", "identities.xml"),
        parts=_parts(root),
        build_types=build_types(root.findall("export/build_type")) or (BUILD_TYPE,),
        role=Role(text(root.find("role")) or Role.SUBJECT),
    )


def build_types(elements: Iterable[etree._Element]) -> tuple[str, ...]:
    """Return the names that ``<build_type>`` elements give, in their order.

    Raises:
        KeymintError: two of them are the same.
    """
    names: list[str] = []
    for element in elements:
        name = text(element) or ""
        message = f"the build type {name!r} is given twice"
        require_new(name, names, element, message, "remove one of the elements", "build-type-doubled")
        names.append(name)
    return tuple(names)


def _parts(root: etree._Element) -> Mapping[str, PackagePart]:
    """Return the parts of build types; governance has elements of its own, which are older than ``<parts>``."""
    parts: dict[str, PackagePart] = {}
    if root.find("governances") is not None:
        parts["governance"] = _group(root, "governances", "governance", "governance.xml")
    for element in root.iterfind("parts/part"):
        name = element.get("name", "")
        message = f"the part {name!r} is given twice"
        require_new(name, parts, element, message, "remove one of the elements", "part-doubled")
        parts[name] = _part(element, element.find("path"), element.find("defaults_path"), f"{name}.xml")
    return parts


def _group(root: etree._Element, group: str, item: str, usual: str) -> PackagePart:
    """Return a part whose elements are named after it, e.g. ``<permissions>`` with ``<permission_path>``."""
    element = root.find(group)
    if element is None:
        return _unmentioned(line(root), usual)
    for tag in ("issuer_name", item):
        _check_single(element, tag, group)
    return _part(element, element.find(f"{item}/{item}_path"), element.find(f"{item}/defaults_path"), usual)


def _check_single(element: etree._Element, tag: str, group: str) -> None:
    """Check that an element occurs once; documents of 2018 could have several, and each package several documents."""
    others = element.findall(tag)[1:]
    if others:
        raise KeymintError(
            f"there are two elements <{tag}> in <{group}>",
            where=place(others[0]),
            help="a package has one authority that signs them; remove one of the elements"
            if tag == "issuer_name"
            else f"a package has one document of each part: move the content of the others into it, and remove <{tag}>",
            code="part-doubled",
        )


def _part(
    element: etree._Element, path: etree._Element | None, defaults: etree._Element | None, usual: str
) -> PackagePart:
    return PackagePart(
        line=line(element),
        path=text(path) or usual,
        named=path is not None,
        defaults=text(defaults) or f"package.defaults/{usual}",
        issuer=text(element.find("issuer_name")) or "",
    )


def _unmentioned(place_line: int, usual: str) -> PackagePart:
    return PackagePart(place_line, usual, named=False, defaults=f"package.defaults/{usual}", issuer="")


read = Reader("keymint_ros", "keymint_package", _manifest)
"""Reads a package manifest."""


def role(content: bytes) -> Role:
    """Return why a package exists: see :meth:`keymint.api.PackageType.role`."""
    try:
        return read(content, MARKER).role
    except KeymintError:
        return Role.SUBJECT


def is_name_of(given: str, package: str) -> bool:
    """Tell whether a name in a document is the package's full name, its last segment, or empty."""
    return given.removeprefix("/") in {"", package, package.rpartition("/")[2]}
