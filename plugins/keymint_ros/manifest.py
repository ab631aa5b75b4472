# SPDX-License-Identifier: Apache-2.0
"""``keymint_package.xml``: makes a folder a package, and names the documents of its parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from lxml import etree

from comarmor.values import Data
from comarmor.xml.reader import line
from keymint.api import Role
from keymint.api.source_documents import Reader, file_in, normal_path, require_new, text
from keymint.errors import KeymintError, Origin

MARKER = "keymint_package.xml"
ISSUANCE = "issuance.xml"
"""What an authority decided about the certificate of the package; see :mod:`keymint_ros.decisions`."""
ADOPTED = "adopted."
"""Prefix of the files of a package that are documents which another tool signed: ``adopted.permissions.xml``."""
BUILD_TYPE = "keymint_ros2_dds"
SIGNER = "permissions_ca"
"""Name of the authority that signs documents, where one alone does; packages of 2018 and new profiles name it."""
_OLDER = (
    ("permissions", "permissions", "permission"),
    ("identities", "identities", "identity"),
    ("governance", "governances", "governance"),
)
"""Parts with elements of their own, e.g. ``<permission_path>`` in ``<permission>`` in ``<permissions>``."""


class PackagePart(Data):
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


class PackageManifest(Data):
    """A package manifest, with the usual paths where it gives none.

    Attributes:
        name: empty if not given; the folder names the package then.
        name_line: line of the name.
        line: line of the root.
        parts: the parts that it mentions, by name.
        build_types: the plugins that build the package.
        role: why the package exists.
    """

    name: str
    name_line: int
    line: int
    parts: Mapping[str, PackagePart]
    build_types: tuple[str, ...]
    role: Role

    def part(self, name: str) -> PackagePart:
        """Return a part, with the usual paths if the manifest does not mention it."""
        usual = f"{name}.xml"
        return self.parts.get(name) or PackagePart(self.line, usual, False, f"package.defaults/{usual}", "")


def _manifest(root: etree._Element) -> PackageManifest:
    name = root.find("name")
    return PackageManifest(
        name=text(name) or "",
        name_line=line(root if name is None else name),
        line=line(root),
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
    """Return the parts; three have elements of their own, which are older than ``<parts>``."""
    parts: dict[str, PackagePart] = {}
    for name, group, item in _OLDER:
        if (element := root.find(group)) is not None:
            for tag in ("issuer_name", item):
                _check_single(element, tag)
            parts[name] = _part(element, f"{name}.xml", f"{item}/{item}_path", f"{item}/defaults_path")
    for element in root.iterfind("parts/part"):
        name = element.get("name", "")
        message = f"the part {name!r} is given twice"
        require_new(name, parts, element, message, "remove one of the elements", "part-doubled")
        parts[name] = _part(element, f"{name}.xml", "path", "defaults_path")
    return parts


def _check_single(element: etree._Element, tag: str) -> None:
    """Check that an element occurs once; documents of 2018 could have several, and each package several documents."""
    help_ = f"a package has one document of each part: move the content of the others into it, and remove <{tag}>"
    if tag == "issuer_name":
        help_ = "a package has one authority that signs them; remove one of the elements"
    message = f"there are two elements <{tag}> in <{element.tag}>"
    for other in element.findall(tag)[1:]:
        require_new(tag, (tag,), other, message, help_, "part-doubled")


def _part(element: etree._Element, usual: str, path_tag: str, defaults_tag: str) -> PackagePart:
    path = element.find(path_tag)
    return PackagePart(
        line=line(element),
        path=text(path) or usual,
        named=path is not None,
        defaults=text(element.find(defaults_tag)) or f"package.defaults/{usual}",
        issuer=text(element.find("issuer_name")) or "",
    )


read = Reader("keymint_ros", "keymint_package", _manifest, ("manifest_documents", "package"))
"""Reads a package manifest."""


def path_of(part: str, folder: str, files: Mapping[str, bytes]) -> str:
    """Return the path of the document of a part, relative to its package.

    Args:
        part: its name.
        folder: the package's folder as the user would type it.
        files: the package's files.

    Raises:
        KeymintError: the manifest is missing or not valid, or the path leads out of the package.
    """
    file = f"{folder}/{MARKER}"
    found = read(file_in(files, MARKER, Origin(folder), "package"), file).part(part)
    return normal_path(found.path, Origin(file, found.line))


def role(content: bytes) -> Role:
    """Return why a package exists: see :meth:`keymint.api.PackageType.role`."""
    try:
        return read(content, MARKER).role
    except KeymintError:
        return Role.SUBJECT


def is_name_of(given: str, package: str) -> bool:
    """Tell whether a name in a document is the package's full name, its last segment, or empty."""
    return given.removeprefix("/") in {"", package, package.rpartition("/")[2]}
