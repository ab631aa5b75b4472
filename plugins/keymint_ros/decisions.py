# SPDX-License-Identifier: Apache-2.0
"""The documents that Keymint writes, and nobody else: what was decided beyond the other documents of the workspace.

- ``issuance.xml`` in a package: about its certificate and its grant;
- ``authority_issuance.xml`` in the profile: about the certificates of authorities;
- ``packages.lock.xml`` in the profile: what its owner accepted of the profiles that ROS packages ship.

A decision about certificates has a table of its fields, by which it is read and written.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from lxml import etree

from comarmor.values import Data, replace
from keymint.api import AcceptedPackage, AuthorityIssuance, CertificateSpec, Issuance, Phase, Rollover
from keymint.api.source_documents import Reader, place, require_new, text
from keymint.errors import KeymintError, Origin, known_authority
from keymint_ros import certificate, validity
from keymint_ros.bootstrap import filled_file
from keymint_ros.manifest import ISSUANCE

AUTHORITY_ISSUANCE = "authority_issuance.xml"
PACKAGES_LOCK = "packages.lock.xml"
COPIES = "packages.lock.d"
"""Folder of the copies of what was accepted, one folder for each package."""
_GENERATIONS = range(10**9)


class _Field(Data):
    """An element of a document, and the attribute of the data that has its name.

    Attributes:
        name: name of both.
        read: returns the value of the element.
        content: returns the content of the element; what ends with a line break is written on lines of its own.
        attributes: returns the attributes of the element, each after a space.
    """

    name: str
    read: Callable[[etree._Element], Any]
    content: Callable[[Any], str] = str
    attributes: Callable[[Any], str] = lambda _: ""


def _values(element: etree._Element, fields: Sequence[_Field]) -> dict[str, Any]:
    """Return the values of the fields whose elements are there; the data has defaults for the others."""
    found = ((field, element.find(field.name)) for field in fields)
    return {field.name: field.read(child) for field, child in found if child is not None}


def _lines(data: object, fields: Sequence[_Field], indentation: str) -> Iterator[str]:
    """Yield the lines of the fields that have a value; a number always is one."""
    for field in fields:
        value = getattr(data, field.name)
        if value or value == 0:
            content = field.content(value)
            start, end = ("\n", indentation) if content.endswith("\n") else ("", "")
            yield f"{indentation}<{field.name}{field.attributes(value)}>{start}{content}{end}</{field.name}>"


def _public_key(pem: bytes, where: Origin | None = None) -> bytes:
    """Return a public key in the one form of PEM that Keymint writes."""
    from keymint.pki import keys  # noqa: PLC0415 - most packages have none, and it takes time to import

    return keys.public_to_pem(keys.public_from_pem(pem, where))


def _pem(content: bytes) -> str:
    return f"{content.decode('ascii').strip()}\n"


_RENEWED = _Field("renewed", validity.date, lambda moment: f"{validity.date_text(moment)}Z")
_EXPOSED = _Field("exposed", text)
_OF_PACKAGE = (
    _Field("generation", lambda element: int(text(element) or "0")),
    _RENEWED,
    _Field(
        "public_key",
        lambda element: _public_key((text(element) or "").encode(), place(element)),
        lambda key: _pem(_public_key(key)),
    ),
    _Field("certificate", certificate.pem, _pem),
    _EXPOSED,
)
_OF_AUTHORITY = (
    _RENEWED,
    _Field("adopted", certificate.pem, _pem),
    _Field(
        "rollover",
        lambda element: Rollover(Phase(element.get("phase", "").strip()), certificate.pem(element)),
        lambda rollover: _pem(rollover.certificate),
        lambda rollover: f' phase="{rollover.phase}"',
    ),
    _EXPOSED,
)


# -- packages ------------------------------------------------------------------------------------------------------

_read_issuance = Reader("keymint_ros", "issuance", lambda root: Issuance(**_values(root, _OF_PACKAGE)))


def issuance(folder: str, files: Mapping[str, bytes]) -> Issuance:
    """Return what the authority decided: see :meth:`keymint.api.PackageType.issuance`."""
    content = files.get(ISSUANCE)
    return Issuance() if content is None else _read_issuance(content, f"{folder}/{ISSUANCE}")


def with_issuance(issued: Issuance) -> Mapping[str, bytes]:
    """Return the document: see :meth:`keymint.api.PackageType.with_issuance`.

    Raises:
        KeymintError: the generation is negative or has more than nine digits, or the public key is none.
    """
    if issued.generation not in _GENERATIONS:
        message = f"{issued.generation} is not a generation from 0 to {_GENERATIONS[-1]}"
        raise KeymintError(message, code="generation-range")
    return {ISSUANCE: filled_file("decisions/issuance.xml", lines=tuple(_lines(issued, _OF_PACKAGE, "  ")))}


# -- authorities ---------------------------------------------------------------------------------------------------


def _authorities(root: etree._Element) -> Mapping[str, tuple[AuthorityIssuance, int]]:
    """Return what was decided by authority, each with its line."""
    found: dict[str, tuple[AuthorityIssuance, int]] = {}
    for element in root.iterfind("authority"):
        name = element.get("name", "").strip()
        message = f"there are two elements for the authority {name!r}"
        require_new(name, found, element, message, "remove one of them", "authority-doubled")
        found[name] = AuthorityIssuance(**_values(element, _OF_AUTHORITY)), place(element).line
    return MappingProxyType(found)


_read_authorities = Reader("keymint_ros", "authority_issuance", _authorities)


def authority_issuance(
    files: Mapping[str, bytes], folder: str, known: Collection[str]
) -> Mapping[str, AuthorityIssuance]:
    """Return what was decided about authorities, by name.

    Args:
        files: the files of the profile by path relative to the profile space.
        folder: the profile space, as the user would type it.
        known: names of the authorities.

    Raises:
        KeymintError: with ``file:line`` of each defect.
    """
    content = files.get(AUTHORITY_ISSUANCE)
    if content is None:
        return {}
    name = f"{folder}/{AUTHORITY_ISSUANCE}"
    found = _read_authorities(content, name)
    for authority, (_, line) in found.items():
        help_ = "restore it in the profile, or remove this element"
        known_authority(authority, known, Origin(name, line), help_=help_)
    return {authority: issued for authority, (issued, _) in found.items()}


def spec_after_decision(spec: CertificateSpec, issued: AuthorityIssuance) -> CertificateSpec:
    """Return the certificate of an authority after what was decided about it."""
    if not issued.adopted:
        # The begin stays: certificates that it issued before would otherwise begin before it.
        end = validity.renewed_period(spec.validity, issued.renewed).not_after
        return replace(spec, validity=replace(spec.validity, not_after=end))
    from keymint.pki import foreign_authorities  # noqa: PLC0415 - few profiles have one, and it takes time to import

    return foreign_authorities.adopted_spec(spec, issued.adopted)


def with_authority_issuance(issuances: Mapping[str, AuthorityIssuance]) -> Mapping[str, bytes]:
    """Return the document: see :meth:`keymint.api.ProfileType.with_authority_issuance`."""
    lines: list[str] = []
    for name, each in issuances.items():
        if each != AuthorityIssuance():
            lines += [f'  <authority name="{name}">', *_lines(each, _OF_AUTHORITY, "    "), "  </authority>"]
    return {AUTHORITY_ISSUANCE: filled_file("decisions/authority_issuance.xml", lines=tuple(lines))}


# -- packages of ROS -----------------------------------------------------------------------------------------------


def _packages(root: etree._Element) -> Mapping[str, AcceptedPackage]:
    found: dict[str, AcceptedPackage] = {}
    for element in root.iterfind("package"):
        name = element.get("name", "")
        _require_one(name, found, element, f"the package {name!r}")
        files: dict[str, str] = {}
        for file in element.iterfind("file"):
            path = file.get("path", "")
            _require_one(path, files, file, f"the file {path!r} of the package {name!r}")
            files[path] = file.get("sha256", "")
        found[name] = AcceptedPackage(MappingProxyType(files), element.get("links") == "follow")
    return MappingProxyType(found)


def _require_one(name: str, known: Container[str], element: etree._Element, shown: str) -> None:
    message, help_ = f"there are two elements for {shown}", "remove one of them, or accept the package again"
    require_new(name, known, element, message, help_, "package-doubled")


_read_packages = Reader("keymint_ros", "packages_lock", _packages)


def accepted_packages(files: Mapping[str, bytes], folder: str) -> Mapping[str, AcceptedPackage]:
    """Return what was accepted, by package.

    Args:
        files: the files of the profile by path relative to the profile space.
        folder: the profile space, as the user would type it.

    Raises:
        KeymintError: with ``file:line`` of each defect.
    """
    content = files.get(PACKAGES_LOCK)
    return {} if content is None else _read_packages(content, f"{folder}/{PACKAGES_LOCK}")


def with_packages(packages: Mapping[str, AcceptedPackage]) -> Mapping[str, bytes]:
    """Return the document: see :meth:`keymint.api.ProfileType.with_packages`."""
    lines: list[str] = []
    for name, package in sorted(packages.items()):
        links = ' links="follow"' if package.follows_links else ""
        files = [f'    <file path="{path}" sha256="{value}"/>' for path, value in sorted(package.files.items())]
        lines += [f'  <package name="{name}"{links}>', *files, "  </package>"]
    return {PACKAGES_LOCK: filled_file("decisions/packages.lock.xml", lines=tuple(lines))}
