# SPDX-License-Identifier: Apache-2.0
"""The inputs of every stage: the workspace, its record, the plugins, the clock, and the loaded profile."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, Self, TypeVar

from comarmor.text import did_you_mean
from comarmor.values import Data, field, replace
from keymint import __version__, api
from keymint.api.plugin_loader import Plugins
from keymint.errors import KeymintError, Origin
from keymint.names import ROOT
from keymint.store.changes import Plan
from keymint.view.stamps import State, digest, digest_files, digest_of_texts
from keymint.view.tree import Tree
from keymint.workspace.workspace import DEFAULTS, PACKAGE_MARKER, PROFILE_MARKER, Workspace, package_paths, packages

if TYPE_CHECKING:
    from keymint.pki.tokens.token_sessions import Tokens

_T = TypeVar("_T")
_P = ParamSpec("_P")
_FILES = "files"
"""First part of the key of what a session knows about the files of a package."""


def once(
    make: Callable[Concatenate[Session, _P], _T], *, of_sources: bool = False
) -> Callable[Concatenate[Session, _P], _T]:
    """Let a function of a session, and perhaps of hashable values, make each result once for a session; a decorator.

    Args:
        make: the function.
        of_sources: see :func:`once_of_sources`.
    """

    @functools.wraps(make)
    def known(session: Session, /, *arguments: _P.args, **named: _P.kwargs) -> _T:
        key = (make, *arguments, *named.items())
        return session.made(key, lambda: make(session, *arguments, **named), of_sources=of_sources)

    return known


def once_of_sources(make: Callable[Concatenate[Session, _P], _T]) -> Callable[Concatenate[Session, _P], _T]:
    """Do the same as :func:`once` for results that depend on the profile and the content of the source space only.

    They are handed on to other sessions until a plan changes that. So what else a result depends on, e.g. the place of
    another space, is an argument.
    """
    return once(make, of_sources=True)


class Inputs(Data):
    """Everything that a stage may read, before the profile is loaded.

    Attributes:
        workspace: paths of the spaces.
        tree: the files, planned changes included.
        state: the record of earlier runs.
        plugins: the installed plugins.
        environment: environment variables; only those that a profile names for passwords are read.
        now: the clock, UTC.
        tokens: returns the tokens that have keys of authorities; opened where something must be signed.
    """

    workspace: Workspace
    tree: Tree
    state: State
    plugins: Plugins
    environment: Mapping[str, str] = field(repr=False)
    now: datetime
    tokens: Callable[[], Tokens] = field(repr=False, compare=False)

    def after(self, plan: Plan) -> Self:
        """Return the inputs as they are once a plan is carried out."""
        return replace(self, tree=self.tree.overlaid(plan.overlay(), plan.held()), state=plan.state)

    def profile_marker(self) -> Origin:
        """Return the location of the profile's main document, for messages."""
        return self.workspace.origin(f"{self.workspace.profile}/{PROFILE_MARKER}")

    def package_marker(self, name: str) -> Origin:
        """Return the location of a package's manifest, for messages."""
        return self.workspace.origin(f"{self.workspace.src}/{name}/{PACKAGE_MARKER}")

    def session(self) -> Session:
        """Load the workspace's profile.

        Raises:
            KeymintError: there is no profile, no plugin recognises it, or it has defects (with ``file:line`` of each).
        """
        root = self.workspace.profile
        files = {
            name: content
            for name, content in self.tree.files(root, suffix=".xml", depth=2).items()
            if "/" not in name or name.split("/")[0].endswith(".defaults")  # others belong to the policy
        }
        if PROFILE_MARKER not in files:
            help_ = "run 'keymint init'"
            raise KeymintError("there is no profile", where=self.profile_marker(), help=help_, code="workspace-missing")
        for plugin in self.plugins.profile_types().values():
            if plugin.recognises(files):
                profile = plugin.load(root, files)
                loaded_from = [digest_files(files), self.plugins.versions, __version__]
                if not profile.distro_named and (distro := self._installed_distro(profile)):
                    profile = plugin.with_distro(profile, distro)
                    loaded_from.append(distro)
                own = self.workspace, self.tree, self.state, self.plugins, self.environment, self.now, self.tokens
                return Session(*own, profile, digest(*loaded_from))
        message = "no installed profile type recognises this profile"
        help_ = "'keymint plugins' lists the installed plugins"
        raise KeymintError(message, where=self.profile_marker(), help=help_, code="profile-unknown")

    def _installed_distro(self, profile: api.WorkspaceProfile) -> str:
        """Return the distribution that installed documents tell, or an empty text."""
        own = (self.plugins.build_type(name, self.profile_marker()) for name in profile.build_types)
        paths = [path for path, _ in self.tree.walk(self.workspace.install)]
        found = (each.distro_of(paths, self.tree.try_read) for each in own)
        return next(filter(None, found), "")


class Session(Inputs, Data):
    """The inputs together with the loaded profile and the source packages.

    Attributes:
        profile: the profile.
        profile_digest: digest of everything that the profile was loaded from.
        vendors_of: the ROS 2 distribution for whose vendors claims are made, if that is not the profile's.
    """

    profile: api.WorkspaceProfile
    profile_digest: str
    vendors_of: str = ""
    _packages: dict[tuple[str, str, bool], api.Package] = field(default_factory=dict, repr=False, compare=False)
    _made_of_sources: dict[tuple[Any, ...], Any] = field(default_factory=dict, repr=False, compare=False)
    _made: dict[tuple[Any, ...], Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def for_vendors_of(self, distro: str | None) -> Self:
        """Return the session with claims for the vendors of a distribution; None: the profile's.

        Raises:
            KeymintError: the distribution is unknown; the exit code is that of a usage error.
        """
        if distro is None or distro == self.profile.distro:
            return self
        self.profile_type.library(distro)
        return replace(self, vendors_of=distro)

    def made(self, key: tuple[Any, ...], make: Callable[[], _T], *, of_sources: bool = False) -> _T:
        """Return a value that depends on this session only, made at the first call.

        Args:
            key: the same for the same value, and for no other one.
            make: makes the value.
            of_sources: it depends on the profile and the source space only, so it is kept until a plan changes these.
        """
        made = self._made_of_sources if of_sources else self._made
        if key not in made:
            made[key] = make()
        value: _T = made[key]
        return value

    @property
    def layouts(self) -> tuple[api.Layout, ...]:
        """The layout of the install space, as each build type of new packages defines it; at least one.

        Raises:
            KeymintError: no build type knows the layout, or one cannot be loaded.
        """
        name, build_types = self.profile.layout, self.build_types.values()
        if layouts := tuple(each.LAYOUTS[name] for each in build_types if name in each.LAYOUTS):
            return layouts
        known = sorted({layout for each in build_types for layout in each.LAYOUTS})
        message = f"no build type of the workspace has a layout {name!r}"
        help_ = did_you_mean(name, known, f"known are {', '.join(known)}")
        raise KeymintError(message, where=self.profile_marker(), help=help_, code="layout-unknown")

    @property
    @once
    def enclaves(self) -> Path:
        """The folder that contains the enclaves; errors as :attr:`layouts`."""
        return self.workspace.install / self.layouts[0].enclaves

    def enclave(self, name: str) -> Path:
        """Return the folder of an enclave; that of the root enclave contains all others. Errors as :attr:`layouts`."""
        return Path(self.enclave_folder(name))

    def enclave_folder(self, name: str) -> str:
        """Return :meth:`enclave` as a text."""
        return str(self.enclaves) if name == ROOT else f"{self.enclaves}/{name}"

    @property
    def profile_type(self) -> api.ProfileType:
        """The type of the profile."""
        return self.plugins.profile_type(self.profile.profile_type)

    @property
    def policy_type(self) -> api.PolicyType:
        """The type of the policy; errors as :meth:`keymint.api.plugin_loader.Plugins.policy_type`."""
        return self.plugins.policy_type(self.profile.policy_type, self.profile_marker())

    @property
    def build_types(self) -> Mapping[str, api.BuildType]:
        """The build types of new packages by name; errors as :meth:`keymint.api.plugin_loader.Plugins.build_type`."""
        return {each: self.plugins.build_type(each, self.profile_marker()) for each in self.profile.build_types}

    @property
    @once
    def package_type(self) -> api.PackageType:
        """The type of the packages; errors as :meth:`keymint.api.plugin_loader.Plugins.package_type`."""
        return self.plugins.package_type(self.profile.package_type, self.profile_marker())

    @once_of_sources
    def packages(self) -> tuple[str, ...]:
        """Return the names of the source packages, sorted; errors as :func:`keymint.workspace.workspace.packages`."""
        return packages(self.tree, self.workspace.src)

    def after(self, plan: Plan) -> Self:
        """Return the session as it is once a plan is carried out."""
        src, made = f"{self.workspace.src}/", self._made_of_sources
        changed = {f"{folder}/" for folder, _, _ in plan.names() if folder.startswith(src)}
        if changed:
            files = [key for key in made if key[0] == _FILES]
            made = {
                key: made[key] for key in files if changed.isdisjoint((f"{src}{key[1]}/", f"{src}{key[1]}/{DEFAULTS}/"))
            }
        tree = self.tree.overlaid(plan.overlay(), plan.held())
        return replace(self, tree=tree, state=plan.state, _made_of_sources=made)

    def apart(self) -> Self:
        """Return the session with a memory of its own: what only this one is asked for is forgotten with it."""
        known = dict(self._packages), dict(self._made_of_sources)
        return replace(self, tree=self.tree.apart(), _packages=known[0], _made_of_sources=known[1])

    def package_files(self, name: str) -> dict[str, bytes]:
        """Return the XML files of a package, those of its ``package.defaults`` included; empty if there is none."""
        paths = package_paths(self.tree, self.workspace, name)
        contents = {file: self.tree.read(path) for file, path in paths.items()}
        return {file: content for file, content in contents.items() if content is not None}

    def file_digests(self, name: str) -> Mapping[str, str]:
        """Return the digest of each file of :meth:`package_files`."""
        return self._sources(name)[0]

    def _sources(self, name: str) -> tuple[Mapping[str, str], str]:
        """Return the digests of the files of a package, and one over all of them."""

        def read() -> tuple[Mapping[str, str], str]:
            paths = package_paths(self.tree, self.workspace, name)
            found = {file: value for file, path in paths.items() if (value := self.tree.digest(path)) is not None}
            return found, _digest_of(found)

        return self.made((_FILES, name), read, of_sources=True)

    @once
    def package(self, name: str, *, built: bool = False) -> api.Package:
        """Load a package, once per run and content; errors as :meth:`keymint.api.PackageType.load`.

        A package of a subject also has the packages of infrastructure that its build types have, whose errors are
        raised as well.

        Args:
            name: the package.
            built: it was built from these files; see :meth:`keymint.api.PackageType.load`.
        """
        package = self._load(name, built=built)
        needing = {each for each in package.build_types if self.plugins.build_type(each).INFRASTRUCTURE}
        if not needing or package.role is api.Role.INFRASTRUCTURE:
            return package
        infrastructure = (self._load(each) for each in self.infrastructure())
        return replace(package, infrastructure=tuple(each for each in infrastructure if needing & {*each.build_types}))

    @once_of_sources
    def infrastructure(self) -> tuple[str, ...]:
        """Return the names of the existing packages of infrastructure, sorted; none if no build type needs any."""
        if not any(each.INFRASTRUCTURE for each in self.build_types.values()):
            return ()
        return tuple(name for name in self.packages() if self.role(name) is api.Role.INFRASTRUCTURE)

    def sources_digest(self, name: str, files: Mapping[str, str] | None = None) -> str:
        """Return the digest of all that a package is loaded from except the profile, its infrastructure included.

        Args:
            name: the package.
            files: the digests of its files, if it is not there yet.
        """
        whole = self._sources(name)[1] if files is None else _digest_of(files)
        if not (infrastructure := self.infrastructure()):
            return whole
        return digest_of_texts(str(self.workspace.install), whole, *map(self._named_digest, infrastructure))

    @once_of_sources
    def _named_digest(self, name: str) -> str:
        """Return a digest of what the documents of other packages may have from a package of infrastructure.

        They name it, so they change with its generation, but not when it is renewed.
        """
        found, whole = self._sources(name)
        try:
            generation = self.issuance(name).generation
        except KeymintError:  # reported when the package is loaded
            return whole
        own = (item for item in sorted(found.items()) if item[0] != self.package_type.ISSUANCE)
        return digest(*(part for item in own for part in item), *((str(generation),) if generation else ()))

    @once_of_sources
    def issuance(self, name: str) -> api.Issuance:
        """Return what the authority decided about a package; the defaults if it has nothing about it.

        Raises:
            KeymintError: the file has defects, with ``file:line`` of each.
        """
        file = self.package_type.ISSUANCE
        if file not in self.file_digests(name):
            return api.Issuance()
        folder = self.workspace.src / name
        return self.package_type.issuance(self.workspace.shown(folder), {file: self.tree.read(folder / file) or b""})

    def issuance_place(self, name: str) -> Origin:
        """Return the place of what the authority decided about a package, or of its manifest if it has none."""
        file = self.package_type.ISSUANCE or self.package_type.MARKER
        return self.workspace.origin(self.workspace.src / name / file)

    def role(self, name: str) -> api.Role:
        """Return why a package exists; the role of a subject if there is none or its manifest has defects."""
        marker = f"{self.workspace.src}/{name}/{self.package_type.MARKER}"
        found = self.tree.digest(marker)
        if found is None:
            return api.Role.SUBJECT
        return self.made(("role", found), lambda: self.package_type.role(self.tree.read(marker) or b""))

    def needed_infrastructure(self) -> Mapping[str, tuple[str, str]]:
        """Return what the packages of infrastructure are for that the profile's build types need, and these, by name.

        Raises:
            KeymintError: two build types need a package of one name, or the profile has a defect.
        """
        needed: dict[str, tuple[str, str]] = {}
        for build_type, plugin in self.build_types.items():
            for name, title in plugin.packages(self.profile).items():
                if name in needed:
                    message = f"{needed[name][0]} and {title} are both named {name!r}"
                    help_ = "give one of them another name"
                    raise KeymintError(message, where=self.profile_marker(), help=help_, code="infrastructure-doubled")
                needed[name] = title, build_type
        return needed

    def _load(self, name: str, *, built: bool = False) -> api.Package:
        key = (name, self._sources(name)[1], built)
        if key not in self._packages:
            files, folder = self.package_files(name), self.workspace.shown(self.workspace.src / name)
            build_type, install = self.plugins.build_type, str(self.workspace.install)
            loaded = self.package_type.load(self.profile, name, folder, files, build_type, install, built=built)
            self._packages[key] = loaded
        return self._packages[key]


def _digest_of(files: Mapping[str, str]) -> str:
    """Return one digest over files, given by their digests."""
    return digest_of_texts(*chain.from_iterable(sorted(files.items())))
