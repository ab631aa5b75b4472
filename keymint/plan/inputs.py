"""What every stage plans from: the workspace as it is, its record, the plugins, the clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from comarmor.errors import Diagnostic, Origin
from keymint import __version__
from keymint.api import Package, Profile
from keymint.errors import KeymintError
from keymint.plan.model import File, FolderChange, Plan
from keymint.plugins import Plugins
from keymint.state import State, digest, digest_files
from keymint.tree import Tree
from keymint.workspace import PACKAGE_MARKER, PROFILE_MARKER, Workspace, package_files, profile_files


@dataclass(frozen=True, slots=True)
class Inputs:
    """All that a stage may look at.

    Attributes:
        workspace: where things lie.
        tree: the files, planned changes included.
        state: the record of earlier runs.
        plugins: what is installed.
        environment: environment variables; only those that a profile names for passwords are read.
        now: the clock, UTC.
    """

    workspace: Workspace
    tree: Tree
    state: State
    plugins: Plugins
    environment: Mapping[str, str] = field(repr=False)
    now: datetime

    def after(self, plan: Plan) -> Inputs:
        """Return the inputs of a stage that plans on top of a plan."""
        return replace(self, tree=self.tree.overlaid(plan.overlay()), state=plan.state)

    def profile_marker(self) -> Origin:
        """Return the place of the profile's main document, for messages."""
        return Origin(self.workspace.shown(self.workspace.profile / PROFILE_MARKER))

    def package_marker(self, name: str) -> Origin:
        """Return the place of a package's manifest, for messages."""
        return Origin(self.workspace.shown(self.workspace.src / name / PACKAGE_MARKER))

    def profile(self) -> LoadedProfile:
        """Load the workspace's profile.

        Raises:
            KeymintError: there is none, no plugin knows it, or it has defects (with ``file:line`` of each).
        """
        root = self.workspace.profile
        files = profile_files(self.tree, root)
        if PROFILE_MARKER not in files:
            raise KeymintError(
                "there is no profile",
                where=self.profile_marker(),
                help="run 'keymint init'",
                code="workspace-missing",
            )
        for plugin in self.plugins.profile_types().values():
            if plugin.recognises(files):
                seen = digest(digest_files(files), self.plugins.versions, __version__)
                return LoadedProfile(plugin.load(root, files), seen)
        raise KeymintError(
            "no installed profile type knows this profile",
            where=self.profile_marker(),
            help="'keymint plugins' lists what is installed",
            code="profile-unknown",
        )


@dataclass(frozen=True, slots=True)
class LoadedProfile:
    """A profile and the digest of all that it was loaded from."""

    profile: Profile
    digest: str


class Sources:
    """The source packages of a workspace; each is loaded at most once per run and content.

    Args:
        plugins: what is installed.
    """

    def __init__(self, plugins: Plugins) -> None:
        self._plugins = plugins
        self._loaded: dict[tuple[str, str], Package] = {}

    def load(self, inputs: Inputs, loaded: LoadedProfile, name: str, files: Mapping[str, bytes]) -> Package:
        """Load a package; errors as :meth:`keymint.api.PackageType.load`."""
        key = (name, digest(loaded.digest, digest_files(files)))
        if key not in self._loaded:
            package_type = self._plugins.package_type(loaded.profile.package_type, inputs.profile_marker())
            folder = inputs.workspace.shown(inputs.workspace.src / name)
            self._loaded[key] = package_type.load(loaded.profile, name, folder, files)
        return self._loaded[key]

    def files(self, inputs: Inputs, name: str) -> dict[str, bytes]:
        """Return the XML files of a package, empty when there is no such package."""
        return package_files(inputs.tree, inputs.workspace.src / name)


def changed(tree: Tree, folder: Path, files: Mapping[str, File], *, private: bool = False) -> tuple[FolderChange, ...]:
    """Return the change that gives a folder these files: only what differs from what is there."""
    different = {name: file for name, file in files.items() if tree.read(folder / name) != file.content}
    return (FolderChange(folder, different, private=private),) if different else ()


def placed(diagnostic: Diagnostic, space: Path) -> Diagnostic:
    """Return a diagnostic whose place, which a plugin knows by package and file only, lies in a space."""
    where = diagnostic.where
    if where is None or where.file.startswith("/"):
        return diagnostic
    return replace(diagnostic, where=replace(where, file=str(space / where.file)))
