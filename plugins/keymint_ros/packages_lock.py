# SPDX-License-Identifier: Apache-2.0
"""``packages.lock.xml``: what the owner of a workspace accepted of the profiles that ROS packages ship.

Keymint writes this file, and nobody else: ``keymint create --accept-package`` records what its owner decided.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from keymint.api import AcceptedPackage
from keymint.api.source_documents import Reader, require_new
from keymint_ros.templates import filled

if TYPE_CHECKING:
    from lxml import etree

FILE = "packages.lock.xml"
COPIES = "packages.lock.d"
"""Folder of the copies of what was accepted, one folder for each package."""


def _packages(root: etree._Element) -> Mapping[str, AcceptedPackage]:
    found: dict[str, AcceptedPackage] = {}
    for element in root.iterfind("package"):
        name = element.get("name", "")
        _require_new(name, found, element, f"the package {name!r}")
        files: dict[str, str] = {}
        for file in element.iterfind("file"):
            path = file.get("path", "")
            _require_new(path, files, file, f"the file {path!r} of the package {name!r}")
            files[path] = file.get("sha256", "")
        found[name] = AcceptedPackage(MappingProxyType(files), element.get("links") == "follow")
    return MappingProxyType(found)


def _require_new(name: str, known: Container[str], element: etree._Element, shown: str) -> None:
    message, help_ = f"there are two elements for {shown}", "remove one of them, or accept the package again"
    require_new(name, known, element, message, help_, "package-doubled")


_read = Reader("keymint_ros", "packages_lock", _packages)


def read(files: Mapping[str, bytes], folder: str) -> Mapping[str, AcceptedPackage]:
    """Return what was accepted, by package.

    Args:
        files: the files of the profile by path relative to the profile space.
        folder: the profile space, as the user would type it.

    Raises:
        KeymintError: with ``file:line`` of each defect.
    """
    content = files.get(FILE)
    return {} if content is None else _read(content, f"{folder}/{FILE}")


def with_packages(packages: Mapping[str, AcceptedPackage]) -> Mapping[str, bytes]:
    """Return the document: see :meth:`keymint.api.AcceptedPackageFiles.with_packages`."""
    lines = (line for name, each in sorted(packages.items()) for line in _lines(name, each))
    return {FILE: filled("decisions/packages.lock.xml", lines=tuple(lines))}


def _lines(name: str, package: AcceptedPackage) -> Iterator[str]:
    links = ' links="follow"' if package.follows_links else ""
    yield f'  <package name="{name}"{links}>'
    for path, value in sorted(package.files.items()):
        yield f'    <file path="{path}" sha256="{value}"/>'
    yield "  </package>"
