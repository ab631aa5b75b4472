# SPDX-License-Identifier: Apache-2.0
"""Find plugins by their entry points, check their version, and report every failure."""

from __future__ import annotations

import contextlib
import functools
import json
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from importlib.machinery import PathFinder
from io import FileIO
from pathlib import Path
from typing import Any, cast

from comarmor.text import did_you_mean
from comarmor.values import Data
from keymint import api
from keymint.api import API_VERSION, BuildType, PackageType, PolicyType, ProfileType
from keymint.errors import ExitCode, KeymintError, Origin

_OURS = "keymint-tools"
GROUPS: Mapping[str, str] = {
    "keymint.profile_types": "ProfileType",
    "keymint.package_types": "PackageType",
    "keymint.policy_types": "PolicyType",
    "keymint.build_types": "BuildType",
    "keymint.transports": "TransportType",
    "keymint.graph_sources": "GraphSource",
    "keymint.policy_formats": "PolicyFormat",
}
"""The entry-point groups, each with the class in :mod:`keymint.api` that its plugins are of."""


class PluginInfo(Data):
    """Metadata of a plugin, read without loading it.

    Attributes:
        group: entry-point group.
        name: name within the group.
        target: ``module:attribute`` that it loads.
        distribution: the installed distribution that registers it.
        version: version of the distribution.
        location: folder of the distribution.
        metadata: folder of its metadata.
    """

    group: str
    name: str
    target: str
    distribution: str = ""
    version: str = ""
    location: str = ""
    metadata: str = ""


def how_to_add(package: str) -> str:
    """Return the command that installs a package into the environment of Keymint.

    It never installs Keymint itself: an index may have another project of that name.
    """
    environment = Path(sys.prefix)
    if (environment / "pipx_metadata.json").is_file():  # pipx may or may not put pip into its environments
        command = ["pipx", "inject", environment.name, package]
    elif PathFinder.find_spec("pip") is None:  # as in the environments that uv makes
        command = ["uv", "pip", "install", "--python", sys.executable, package]
    else:
        command = [sys.executable, "-m", "pip", "install", package]
    return shlex.join(command)


def _kind(group: str) -> str:
    return group.removeprefix("keymint.").removesuffix("s").replace("_", " ")


def _source(info: PluginInfo) -> str:
    """Return the distribution to reinstall, and its source (PEP 610)."""
    try:
        url = json.loads(Path(info.metadata, "direct_url.json").read_bytes()).get("url", "")
    except (OSError, ValueError, AttributeError):
        url = ""
    name = info.distribution
    if url:
        return f"{name or 'it'} from {url}"
    return name if name and name != _OURS else "it from its checkout or wheel"


def _brought_by(info: PluginInfo) -> str:
    """Return the identity of a distribution: its name, or its location if it has no name."""
    return info.distribution or info.location


def entries_of(metadata: str) -> Iterator[PluginInfo]:
    """Yield the entry points of our groups that a distribution registers.

    :mod:`importlib.metadata` would take longer than everything else in a short run: it parses the metadata of all
    distributions as e-mails.

    Args:
        metadata: its folder of metadata; if that is damaged, it must not hide a plugin.
    """
    try:
        with FileIO(f"{metadata}/entry_points.txt") as opened:
            content = opened.readall()
        if b"[keymint." not in content:
            return
        text = content.decode()
    except (OSError, ValueError):
        return
    group, headers, location = "", _headers(metadata), str(Path(metadata).parent)
    for line in map(str.strip, text.splitlines()):
        name, equals, target = line.partition("=")
        if line.startswith("["):
            group = line.strip("[]")
        elif group in GROUPS and equals and not line.startswith("#"):
            yield PluginInfo(group, name.strip(), target.strip(), *headers, location, metadata)


def _headers(metadata: str) -> tuple[str, str]:
    """Return the name and the version of a distribution, or empty texts."""
    found = {"Name": "", "Version": ""}
    for file in ("METADATA", "PKG-INFO"):
        with contextlib.suppress(OSError):
            for line in Path(metadata, file).read_text(encoding="utf-8", errors="replace").splitlines():
                if not line:
                    break
                header, _, value = line.partition(":")
                if header in found:
                    found[header] = found[header] or value.strip()
    return found["Name"], found["Version"]


def entries_in(metadata: Iterable[str]) -> Iterator[PluginInfo]:
    """Yield the entry points of our groups; a distribution that is installed twice counts once.

    Args:
        metadata: the folders of metadata, that of what is imported first.
    """
    seen: set[str] = set()
    for found in filter(None, map(tuple, map(entries_of, metadata))):
        identity = re.sub(r"[-_.]+", "-", found[0].distribution).lower()
        if identity not in seen or not identity:
            yield from found
        seen.add(identity)


class Plugins:
    """The installed plugins; each is loaded on first use.

    Args:
        entries: the entry points to use, e.g. :func:`entries_in` what is installed.
        environment: returns what transports are opened with; without it there are none to ask for.
    """

    def __init__(self, entries: Iterable[PluginInfo], environment: Callable[[], api.Environment] | None = None) -> None:
        self._environment = environment and functools.cache(environment)
        self._transports: dict[str, api.Transport] = {}
        self._entries: dict[str, dict[str, list[PluginInfo]]] = {}
        self._loaded: dict[tuple[str, str], object] = {}
        for entry in entries:
            versions = self._entries.setdefault(entry.group, {}).setdefault(entry.name, [])
            # The same distribution seen twice on sys.path is one plugin, two distributions are two.
            if all(_brought_by(entry) != _brought_by(other) for other in versions):
                versions.append(entry)

    @functools.cached_property
    def infos(self) -> tuple[PluginInfo, ...]:
        """Metadata of all plugins, sorted by group and name, including duplicates."""
        return tuple(entry for group in GROUPS for name in self.names(group) for entry in self._entries[group][name])

    @functools.cached_property
    def versions(self) -> str:
        """The versions of all plugins as one text; when it changes, builds are stale."""
        return "\n".join(f"{info.group}/{info.name}/{info.distribution}/{info.version}" for info in self.infos)

    def names(self, group: str) -> tuple[str, ...]:
        """Return the names of the plugins of a group, sorted, without loading them.

        Args:
            group: a key of :data:`GROUPS`.
        """
        return tuple(sorted(self._entries.get(group, {})))

    def profile_type(self, name: str) -> ProfileType:
        """Return the profile type of this name; see :meth:`load`."""
        return cast("ProfileType", self.load("keymint.profile_types", name))

    def profile_types(self) -> Mapping[str, ProfileType]:
        """Return all profile types by name; see :meth:`load`."""
        return {name: self.profile_type(name) for name in self.names("keymint.profile_types")}

    def package_type(self, name: str, where: Origin | None = None) -> PackageType:
        """Return the package type of this name; see :meth:`load`."""
        return cast("PackageType", self.load("keymint.package_types", name, where))

    def policy_type(self, name: str, where: Origin | None = None) -> PolicyType:
        """Return the policy type of this name; see :meth:`load`."""
        return cast("PolicyType", self.load("keymint.policy_types", name, where))

    def policy_types(self) -> Mapping[str, PolicyType]:
        """Return all policy types by name; see :meth:`load`."""
        return {name: self.policy_type(name) for name in self.names("keymint.policy_types")}

    def build_type(self, name: str, where: Origin | None = None) -> BuildType:
        """Return the build type of this name; see :meth:`load`."""
        return cast("BuildType", self.load("keymint.build_types", name, where))

    def transport(self, name: str) -> api.Transport:
        """Return the transport of this name, opened once in the environment; see :meth:`load`."""
        if name not in self._transports:
            if self._environment is None:
                raise ValueError("transports are opened in environment")
            opener = cast("api.TransportType", self.load("keymint.transports", name))
            self._transports[name] = opener.open(self._environment())
        return self._transports[name]

    def transports(self) -> Mapping[str, api.Transport]:
        """Return all transports by name, sorted; see :meth:`transport`."""
        return {name: self.transport(name) for name in self.names("keymint.transports")}

    def read_by(self, transport: str) -> str:
        """Return the name of the build type whose files a transport reads; see :meth:`load`."""
        return cast("api.TransportType", self.load("keymint.transports", transport)).BUILD_TYPE

    def transports_of(self, build_type: str, distro: str = "") -> Sequence[str]:
        """Return the names of the transports that read what a build type builds, sorted.

        Args:
            build_type: name of the build type.
            distro: leave out models of what this ROS 2 distribution does not ship; empty for all.
        """
        plugin = self.build_type(build_type) if distro else None
        others = plugin.models().keys() - plugin.models(distro) if plugin else frozenset[str]()
        named = (name for name in self.names("keymint.transports") if name not in others)
        return [name for name in named if self.read_by(name) == build_type]

    def graph_source(self, name: str) -> api.GraphSource:
        """Return the graph source of this name; see :meth:`load`."""
        return cast("api.GraphSource", self.load("keymint.graph_sources", name))

    def policy_format(self, name: str) -> api.PolicyFormat:
        """Return the policy format of this name; see :meth:`load`."""
        return cast("api.PolicyFormat", self.load("keymint.policy_formats", name))

    def load(self, group: str, name: str, where: Origin | None = None) -> Any:
        """Return a plugin object.

        Args:
            group: a key of :data:`GROUPS`.
            name: the plugin's name.
            where: the place that names it, for the message.

        Raises:
            KeymintError: no plugin has this name, two distributions provide it, it fails to load, or it is of
                another major version of the plugin interface, or of another class.
        """
        if (group, name) in self._loaded:
            return self._loaded[group, name]
        self.require(group, name, where, ExitCode.FAILURE)

        def refusal(defect: str, help_: str, code: str) -> KeymintError:
            return KeymintError(f"the {_kind(group)} {name!r} {defect}", where=where, help=help_, code=code)

        entries = self._entries[group][name]
        if len(entries) > 1:
            brought_by = " and ".join(sorted(map(_brought_by, entries)))
            raise refusal(f"is provided by {brought_by}", "uninstall all but one", "plugin-doubled")
        entry = entries[0]
        try:
            module, _, attribute = entry.target.partition(" ")[0].partition(":")
            plugin: object = functools.reduce(getattr, filter(None, attribute.split(".")), import_module(module))
        except Exception as error:
            defect = f"({entry.target}) fails to load: {type(error).__name__}: {error}"
            raise refusal(defect, f"reinstall {_source(entry)}", "plugin-broken") from error
        version, base = getattr(plugin, "API", None), getattr(api, GROUPS[group])
        defect = ""
        if not isinstance(version, str) or version.partition(".")[0] != API_VERSION.partition(".")[0]:
            defect = f"implements version {version!r} of the plugin interface, this Keymint needs {API_VERSION!r}"
        elif not isinstance(plugin, base):
            defect = f"is no {base.__name__} of keymint.api"
        if defect:
            other = f"install a version of {entry.distribution or 'it'} for this Keymint"
            help_ = f"{other}, or change its code as docs/migrating-plugins.md says"
            raise refusal(f"({entry.target}) {defect}", help_, "plugin-version")
        self._loaded[group, name] = plugin
        return plugin

    def require(self, group: str, name: str, where: Origin | None = None, exit_code: ExitCode = ExitCode.USAGE) -> None:
        """Require that a plugin is installed, without loading it.

        Args:
            group: a key of :data:`GROUPS`.
            name: the plugin's name.
            where: the place that names it, for the message.
            exit_code: exit code if it is missing; by default that of a usage error.

        Raises:
            KeymintError: no plugin has this name; the help names a similar one.
        """
        known = self._entries.get(group, {})
        if name not in known:
            message = f"no {_kind(group)} {name!r} is installed"
            help_ = did_you_mean(name, known, "'keymint plugins' lists the installed ones")
            raise KeymintError(message, where=where, help=help_, code="plugin-unknown", exit_code=exit_code)
