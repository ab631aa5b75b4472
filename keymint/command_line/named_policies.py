# SPDX-License-Identifier: Apache-2.0
"""Load the policies that the command line names: files, directories and workspaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from comarmor.xml.package_folders import InstalledPackages
from keymint.api import LoadedPolicy, PolicySource
from keymint.command_line.options import DEFAULT_DISTRO, PolicyOptions
from keymint.errors import KeymintError, Origin, library_name
from keymint.run.run import Run
from keymint.workspace.policy_loading import accepted_policy, foreign_policy, load_policy
from keymint.workspace.session import Session
from keymint.workspace.workspace import Workspace


class Policies:
    """Loads the policies that a command line names.

    Args:
        run: the run.
        options: how to read a policy outside of a workspace.

    Attributes:
        distro: ROS 2 distribution of the policy that was loaded last.
        build_types: build types of new packages of its workspace; outside of one, those of a new workspace.
    """

    def __init__(self, run: Run, options: PolicyOptions) -> None:
        self._run = run
        self._options = options
        self.distro = options.distro or run.setting.environment.get("ROS_DISTRO") or DEFAULT_DISTRO
        self.build_types = run.plugins.profile_type(options.profile_type).BUILD_TYPES

    def load(self, path: Path | None, *, as_accepted: bool = False) -> LoadedPolicy:
        """Load the policy at a path, or of the workspace there; without a path, of the current workspace.

        Args:
            path: the path, or None.
            as_accepted: read what ROS packages ship from the copies that a workspace has, not from where they are
                installed: its policy is not the present one.

        Raises:
            KeymintError: the policy is missing, or has defects.
        """
        cwd = self._run.setting.cwd
        workspace = self._run.workspace() if path is None else Workspace.at(cwd / path, {}, cwd)
        if path is not None and not workspace.exists():
            return self.at(cwd / path, str(path))
        session = self._run.inputs(workspace).session()
        if self._options.distro is None:
            self.distro = session.profile.distro
        self.build_types = session.profile.build_types
        return accepted_policy(session) if as_accepted else load_policy(session, trust_links=self._options.trust_links)

    def shipped(self) -> Path:
        """Return the directory of the policy library that ships with Keymint.

        Raises:
            KeymintError: the distribution is not known.
        """
        return self._run.plugins.profile_type(self._options.profile_type).library(self.distro)

    def at(self, path: Path, typed: str, *, foreign: bool = True, library_shown: Path | None = None) -> LoadedPolicy:
        """Load the policy at a path.

        Args:
            path: file or folder.
            typed: the path as the user typed it.
            foreign: a file that only another policy type recognises is read by that; else it is refused.
            library_shown: path of the library in the places of rules, if it will be copied there.

        Raises:
            KeymintError: the policy is missing, or has defects.
        """
        source, plugins, name = PolicySource(typed, path, Origin(typed)), self._run.plugins, self._options.policy_type
        packages = InstalledPackages(self._run.setting.environment, None if self._options.trust_links else frozenset())
        try:
            return plugins.policy_type(name).load([source], self.shipped(), library_shown, packages)
        except KeymintError as error:
            found = foreign_policy(plugins, [path], name)
            if found is None:
                raise
            if found.path != path or not foreign:
                raise found.refusal(self._run.typed(str(found.path))) from error
        return plugins.policy_type(found.policy_type).load([source], self.shipped(), library_shown)

    def library(self, path: Path | None) -> Callable[[str], str | None]:
        """Return a function that names a file of the shipped library, or of an unchanged copy; None for other files."""
        folder = self.places(path)[1]
        name = library_files(self._run.setting.cwd, self.shipped(), folder)

        def name_of(file: str) -> str | None:
            is_copy = (self._run.setting.cwd / file).resolve().is_relative_to(folder / "common")
            return name(file) if is_copy else library_name(file)

        return cache(name_of)

    def common(self, path: Path | None) -> Callable[[Origin], bool]:
        """Return a function that returns whether a rule belongs to the shipped ``common/node.xml``, for every node."""
        library = self.library(path)
        return lambda where: (library(where.file) or "").startswith(("common/node.xml", "common/node/"))

    def places(self, path: Path | None) -> tuple[Sequence[Path], Path]:
        """Return the resolved paths of the policies that :meth:`load` reads, and of the library that they include."""
        folder = self._run.setting.cwd / path if path is not None else None
        workspace = Workspace.at(folder, {}, self._run.setting.cwd) if folder else self._run.workspace()
        shipped = self.shipped()
        if folder and not workspace.exists():
            return (folder.resolve(),), shipped.resolve()
        profile = self._run.inputs(workspace).session().profile
        return tuple(source.path.resolve() for source in profile.policies), (profile.library or shipped).resolve()


def library_files(cwd: Path, shipped: Path, copy: Path | None = None) -> Callable[[str], str | None]:
    """Return a function that gives the name by which policies include a file of the library, or None for other files.

    Args:
        cwd: folder that relative paths start from.
        shipped: folder of the library.
        copy: folder of a workspace with a copy of the library. A file in it counts only while it is unchanged: rules
            that a person wrote must not be hidden as rules that every node has.
    """
    folders = tuple(folder.resolve() for folder in (shipped, copy) if folder is not None)

    @cache
    def name(file: str) -> str | None:
        path = (cwd / file).resolve()
        relative = (path.relative_to(folder) for folder in folders if path.is_relative_to(folder))
        return next((str(each) for each in relative if is_unchanged(path, shipped / each)), None)

    def is_unchanged(path: Path, original: Path) -> bool:
        try:
            return path.read_bytes() == original.read_bytes()
        except OSError:
            return False

    return name


def library_rules(cwd: Path, shipped: Path, copy: Path | None = None) -> Callable[[Origin], bool]:
    """Return a function that tells whether a rule is one of the library; arguments as :func:`library_files`."""
    name = library_files(cwd, shipped, copy)
    return lambda where: name(where.file) is not None


def workspace_library_rules(session: Session) -> Callable[[Origin], bool]:
    """Return a function that tells whether a rule is one of the library that a workspace uses."""
    profile = session.profile
    shipped = session.plugins.profile_type(profile.profile_type).library(profile.distro)
    return library_rules(session.workspace.shown_from, shipped, profile.library)
