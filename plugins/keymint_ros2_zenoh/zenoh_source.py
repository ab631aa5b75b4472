# SPDX-License-Identifier: Apache-2.0
"""``zenoh.xml``: the router, and where the keystore lies on the robot, from a package's document and its defaults."""

from __future__ import annotations

from ipaddress import ip_address
from typing import TYPE_CHECKING

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.regex import lazy_regex
from comarmor.text import quoted
from comarmor.values import dataclass
from comarmor.xml.reader import line
from keymint.api import (
    Extension,
    InfrastructurePackage,
    PackageSettings,
    PackageSources,
    Role,
    SourcePart,
    WorkspaceProfile,
)
from keymint.errors import KeymintError
from keymint.source_documents import Reader, text
from keymint_ros2_zenoh.lowering.names import check_distro
from keymint_ros2_zenoh.settings import Router, ZenohSettings, is_address

if TYPE_CHECKING:
    from lxml import etree

PART = "zenoh"
"""Name of the part of a package that this module reads."""
_LABEL = r"(?!-)[A-Za-z0-9-]{1,63}(?<!-)"
_DNS_NAME = lazy_regex(rf"(?!.*\.[0-9]+$)(?=.{{1,253}}$){_LABEL}(\.{_LABEL})*")
"""A DNS name (RFC 1123, 2.1), whose last label is no number, which would be an IPv4 address."""


_EXAMPLE = "<zenoh><router><name>zenoh_router</name><host>localhost</host><port>7447</port></router></zenoh>"


@dataclass(frozen=True, slots=True)
class _Value:
    """The text of an element and its line."""

    text: str
    line: int


@dataclass(frozen=True, slots=True)
class _Document:
    """A ``zenoh.xml``: its elements by path, such as ``router/host``."""

    line: int
    values: tuple[tuple[str, _Value], ...]


_PATHS = ("router/name", "router/host", "router/port", "keystore")


def _document(root: etree._Element) -> _Document:
    found = ((path, root.find(path)) for path in _PATHS)
    return _Document(
        line(root),
        tuple((path, _Value(text(element) or "", line(element))) for path, element in found if element is not None),
    )


_read = Reader("keymint_ros2_zenoh", "source_zenoh", _document)


def settings(sources: PackageSources) -> PackageSettings:
    """Return the router of a package, and extensions of its certificate; see :meth:`keymint.api.BuildType.settings`.

    The certificate of a node is for clients only, that of the router for servers only, with the name of its host.

    Raises:
        KeymintError: the distribution has no rmw_zenoh, or a value is missing or not usable; with ``file:line``.
    """
    part = sources.parts[PART]
    try:
        check_distro(sources.distro)
    except KeymintError as error:
        raise KeymintError.of(
            Diagnostic(each.code, each.severity, each.message, part.where, each.help) for each in error.diagnostics
        ) from None
    found = _Values(part)
    router = Router(found.name(), found.host(), found.port(), found.where("router/host"))
    keystore = found.keystore(sources.install_space)
    if found.defects:
        raise KeymintError.of(found.defects)
    is_server = sources.name == router.name
    if is_server != (sources.role is Role.INFRASTRUCTURE):
        message, help_ = (
            (f"the router {router.name!r} is a subject of the policy", "give the router or the subject another name")
            if is_server
            else (
                f"the package {sources.name} is of a router, but the router is {router.name!r}",
                "remove the package's folder, then run 'keymint create --all', or give the router its old name",
            )
        )
        raise KeymintError(message, where=found.where("router/name"), help=help_, code="zenoh-router-name")
    origin = found.where("router/host")
    usage = Extension("extendedKeyUsage", "serverAuth" if is_server else "clientAuth", False, origin)
    host = Extension("subjectAltName", f"{'IP' if is_address(router.host) else 'DNS'}:{router.host}", False, origin)
    return PackageSettings(ZenohSettings(router, keystore), (usage, host) if is_server else (usage,))


def packages(profile: WorkspaceProfile) -> tuple[InfrastructurePackage, ...]:
    """Return the package of the router; see :meth:`keymint.api.Infrastructure.packages`.

    Raises:
        KeymintError: the distribution has no rmw_zenoh, or the defaults are missing or not valid.
    """
    check_distro(profile.distro)
    path = f"package.defaults/{PART}.xml"
    shown = path if profile.library is None else str(profile.library.parent / path)
    content = profile.files.get(path)
    if content is None:
        raise _missing_file(shown, Origin(shown))
    document = _read(content, shown)
    name = dict(document.values).get("router/name")
    if name is None:
        raise _missing("router/name", Origin(shown, document.line))
    return (InfrastructurePackage(name.text, "the Zenoh router"),)


class _Values:
    """The values of a package: those of its own document before those of the defaults.

    Args:
        part: both documents.
    """

    def __init__(self, part: SourcePart) -> None:
        if part.defaults is None:
            raise _missing_file(part.defaults_file, part.where)
        self.defects: list[Diagnostic] = []
        self._values: dict[str, tuple[str, Origin]] = {}
        defaults = _read(part.defaults, part.defaults_file)
        self._defaults = Origin(part.defaults_file, defaults.line)
        documents = [(defaults, part.defaults_file)]
        if part.content is not None:
            documents.append((_read(part.content, part.file), part.file))
        for document, file in documents:
            for path, value in document.values:
                self._values[path] = value.text, Origin(file, value.line)

    def where(self, path: str) -> Origin:
        """Return where a value is written, or should be."""
        return self._values.get(path, ("", self._defaults))[1]

    def name(self) -> str:
        """Return the name of the router's package."""
        return self._required("router/name")

    def host(self) -> str:
        """Return the host of the router."""
        host = self._required("router/host")
        if host and (not _DNS_NAME.fullmatch(host) if not is_address(host) else not _is_reachable(host)):
            self._defect(
                "zenoh-host",
                f"the host {quoted(host)} is neither a DNS name nor the IP address of one machine",
                "router/host",
                "write the name or address by which sessions reach the router, e.g. robot1.local",
            )
        return host

    def port(self) -> int:
        """Return the port of the router."""
        text_ = self._required("router/port")
        return int(text_) if text_ else 0

    def keystore(self, install_space: str) -> str:
        """Return the path of the install space on the robot.

        Args:
            install_space: its path on this machine, which applies if the documents give none.
        """
        path, where = self._values.get("keystore", (install_space, self._defaults))
        if not path.startswith("/") or ".." in path.split("/") or "//" in path or not path.isprintable():
            self.defects.append(
                Diagnostic(
                    "zenoh-keystore", Severity.ERROR, f"the keystore {quoted(path)} is not an absolute path", where,
                    "write the path of the install space on the robot, e.g. /etc/keymint/install",
                )
            )  # fmt: skip
        return path.rstrip("/")

    def _required(self, path: str) -> str:
        if path not in self._values:
            self.defects += _missing(path, self._defaults).diagnostics
            return ""
        return self._values[path][0]

    def _defect(self, code: str, message: str, path: str, help_: str) -> None:
        self.defects.append(Diagnostic(code, Severity.ERROR, message, self.where(path), help_))


def _is_reachable(address: str) -> bool:
    """Return whether an IP address is that of one machine, without a zone, which no certificate has."""
    parsed = ip_address(address)
    return not (parsed.is_unspecified or parsed.is_multicast or "%" in address)


def _missing(path: str, where: Origin) -> KeymintError:
    tag = path.rpartition("/")[2]
    return KeymintError(
        f"there is no <{tag}> of the router, neither in the package's document nor in these defaults",
        where=where,
        help=f"add a <{tag}>",
        code="zenoh-incomplete",
    )


def _missing_file(file: str, where: Origin) -> KeymintError:
    return KeymintError(
        f"there is no file {quoted(file, 200)} in the package or its profile",
        where=where,
        help=f"write it, for example: {_EXAMPLE}",
        code="file-missing",
    )
