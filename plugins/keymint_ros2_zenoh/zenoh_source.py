# SPDX-License-Identifier: Apache-2.0
"""``zenoh.xml``: the router, and where the keystore lies on the robot, from a package's document and its defaults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from ipaddress import ip_address
from typing import TYPE_CHECKING

from comarmor.text import lazy_regex, quote
from comarmor.xml.reader import line
from keymint.api import Extension, PackageSettings, PackageSources, Role, SourcePart, WorkspaceProfile
from keymint.api.source_documents import Reader, text
from keymint.errors import Diagnostic, KeymintError, Origin, require_none
from keymint_ros2_zenoh.lowering.permissions import check_distro
from keymint_ros2_zenoh.settings import Router, ZenohSettings, is_address

if TYPE_CHECKING:
    from lxml import etree

PART = "zenoh"
"""Name of the part of a package that this module reads."""
_LABEL = r"(?!-)[A-Za-z0-9-]{1,63}(?<!-)"
_DNS_NAME = lazy_regex(rf"(?!.*\.[0-9]+$)(?=.{{1,253}}$){_LABEL}(\.{_LABEL})*")
"""A DNS name (RFC 1123, 2.1), whose last label is no number, which would be an IPv4 address."""


_EXAMPLE = "<zenoh><router><name>zenoh_router</name><host>localhost</host><port>7447</port></router></zenoh>"
_REQUIRED = ("router/name", "router/host", "router/port")
_ROOT = ""
"""The path of the root element."""
_Document = Mapping[str, tuple[str, int]]
"""The text and the line of each element of a ``zenoh.xml``, by its path."""
_Values = Mapping[str, tuple[str, Origin]]


def _document(root: etree._Element) -> _Document:
    found = {path: root.find(path) for path in (*_REQUIRED, "keystore")}
    values = {path: (text(element) or "", line(element)) for path, element in found.items() if element is not None}
    return {_ROOT: ("", line(root)), **values}


_read = Reader("keymint_ros2_zenoh", "source_zenoh", _document)


def settings(sources: PackageSources) -> PackageSettings:
    """Return the router of a package, and extensions of its certificate; see :meth:`keymint.api.BuildType.settings`.

    The certificate of a node is for clients only, that of the router for servers only, with the name of its host.

    Raises:
        KeymintError: the distribution has no rmw_zenoh, or a value is missing or not usable; with ``file:line``.
    """
    part = sources.parts[PART]
    check_distro(sources.distro, part.where)
    values = _values(part, sources.install_space)
    require_none(_defects(values))
    (name, named_at), (host, host_at), (port, _) = (values[path] for path in _REQUIRED)
    router = Router(name, host, int(port), host_at)
    is_server = sources.name == name
    if is_server != (sources.role is Role.INFRASTRUCTURE):
        message, help_ = (
            (f"the router {router.name!r} is a subject of the policy", "give the router or the subject another name")
            if is_server
            else (
                f"the package {sources.name} is of a router, but the router is {router.name!r}",
                "remove the package's folder, then run 'keymint create --all', or give the router its old name",
            )
        )
        raise KeymintError(message, where=named_at, help=help_, code="zenoh-router-name")
    usage = Extension("extendedKeyUsage", "serverAuth" if is_server else "clientAuth", False, host_at)
    names = Extension("subjectAltName", f"{'IP' if is_address(host) else 'DNS'}:{host}", False, host_at)
    own = ZenohSettings(router, values["keystore"][0].rstrip("/"))
    return PackageSettings(own, (usage, names) if is_server else (usage,))


def packages(profile: WorkspaceProfile) -> Mapping[str, str]:
    """Return the package of the router; see :meth:`keymint.api.BuildType.packages`.

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
    if "router/name" not in document:
        raise KeymintError.of([_missing("router/name", Origin(shown, document[_ROOT][1]))])
    return {document["router/name"][0]: "the Zenoh router"}


def _values(part: SourcePart, install_space: str) -> _Values:
    """Return the values of a package: those of its own document before those of the defaults.

    Args:
        part: both documents.
        install_space: the keystore if the documents give none.
    """
    if part.defaults is None:
        raise _missing_file(part.defaults_file, part.where)
    defaults = _read(part.defaults, part.defaults_file)
    own = {} if part.content is None else _read(part.content, part.file)
    values = {"keystore": (install_space, Origin(part.defaults_file, defaults[_ROOT][1]))}
    values |= {path: (found, Origin(part.defaults_file, at)) for path, (found, at) in defaults.items()}
    return values | {path: (found, Origin(part.file, at)) for path, (found, at) in own.items() if path != _ROOT}


def _defects(values: _Values) -> Iterator[Diagnostic]:
    yield from (_missing(path, values[_ROOT][1]) for path in _REQUIRED if path not in values)
    host, where = values.get("router/host", values[_ROOT])
    if host and (not (_is_reachable(host) if is_address(host) else _DNS_NAME.fullmatch(host))):
        message = f"the host {quote(host)} is neither a DNS name nor the IP address of one machine"
        help_ = "write the name or address by which sessions reach the router, e.g. robot1.local"
        yield Diagnostic.error("zenoh-host", message, where, help_)
    path, where = values["keystore"]
    if not path.startswith("/") or ".." in path.split("/") or "//" in path or not path.isprintable():
        message = f"the keystore {quote(path)} is not an absolute path"
        help_ = "write the path of the install space on the robot, e.g. /etc/keymint/install"
        yield Diagnostic.error("zenoh-keystore", message, where, help_)


def _is_reachable(address: str) -> bool:
    """Return whether an IP address is that of one machine, without a zone, which no certificate has."""
    parsed = ip_address(address)
    return not (parsed.is_unspecified or parsed.is_multicast or "%" in address)


def _missing(path: str, where: Origin) -> Diagnostic:
    tag = path.rpartition("/")[2]
    message = f"there is no <{tag}> of the router, neither in the package's document nor in these defaults"
    return Diagnostic.error("zenoh-incomplete", message, where, f"add a <{tag}>")


def _missing_file(file: str, where: Origin) -> KeymintError:
    message = f"there is no file {quote(file, 200)} in the package or its profile"
    return KeymintError(message, where=where, help=f"write it, for example: {_EXAMPLE}", code="file-missing")
