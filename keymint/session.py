# SPDX-License-Identifier: Apache-2.0
"""The inputs of every stage: the workspace, its record, the plugins, the clock, and the loaded profile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Self

from comarmor.errors import Origin
from comarmor.text import did_you_mean
from keymint import __version__
from keymint.api import Layout, Package, WorkspaceProfile
from keymint.changes import Plan
from keymint.errors import KeymintError
from keymint.plugins import Plugins
from keymint.state import State, digest, digest_files
from keymint.tree import Tree
from keymint.workspace import PACKAGE_MARKER, PROFILE_MARKER, Workspace, package_files, profile_files


@dataclass(frozen=True, slots=True)
class Inputs:
    """Everything that a stage may read, before the profile is loaded.

    Attributes:
        workspace: paths of the spaces.
        tree: the files, planned changes included.
        state: the record of earlier runs.
        plugins: the installed plugins.
        environment: environment variables; only those that a profile names for passwords are read.
        now: the clock, UTC.
    """

    workspace: Workspace
    tree: Tree
    state: State
    plugins: Plugins
    environment: Mapping[str, str] = field(repr=False)
    now: datetime

    def after(self, plan: Plan) -> Self:
        """Return the inputs as they are once a plan is carried out."""
        return replace(self, tree=self.tree.overlaid(plan.overlay()), state=plan.state)

    def profile_marker(self) -> Origin:
        """Return the location of the profile's main document, for messages."""
        return Origin(self.workspace.shown(self.workspace.profile / PROFILE_MARKER))

    def package_marker(self, name: str) -> Origin:
        """Return the location of a package's manifest, for messages."""
        return Origin(self.workspace.shown(self.workspace.src / name / PACKAGE_MARKER))

    def session(self) -> Session:
        """Load the workspace's profile.

        Raises:
            KeymintError: there is no profile, no plugin recognises it, or it has defects (with ``file:line`` of each).
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
                return Session(
                    self.workspace,
                    self.tree,
                    self.state,
                    self.plugins,
                    self.environment,
                    self.now,
                    profile=plugin.load(root, files),
                    profile_digest=digest(digest_files(files), self.plugins.versions, __version__),
                )
        raise KeymintError(
            "no installed profile type recognises this profile",
            where=self.profile_marker(),
            help="'keymint plugins' lists the installed plugins",
            code="profile-unknown",
        )


@dataclass(frozen=True, slots=True)
class Session(Inputs):
    """The inputs together with the loaded profile and the source packages.

    Attributes:
        profile: the profile.
        profile_digest: digest of everything that the profile was loaded from.
    """

    profile: WorkspaceProfile
    profile_digest: str
    _packages: dict[tuple[str, str], Package] = field(default_factory=dict, repr=False, compare=False)

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """The layout of the install space, as each build type of new packages defines it; at least one.

        Raises:
            KeymintError: no build type knows the layout, or one cannot be loaded.
        """
        name, where = self.profile.layout, self.profile_marker()
        build_types = [self.plugins.build_type(each, where) for each in self.profile.build_types]
        if layouts := tuple(each.LAYOUTS[name] for each in build_types if name in each.LAYOUTS):
            return layouts
        known = sorted({layout for each in build_types for layout in each.LAYOUTS})
        raise KeymintError(
            f"no build type of the workspace has a layout {name!r}",
            where=where,
            help=did_you_mean(name, known, f"known are {', '.join(known)}"),
            code="layout-unknown",
        )

    @property
    def enclaves(self) -> Path:
        """The folder that contains the enclaves; errors as :attr:`layouts`."""
        return self.workspace.install / self.layouts[0].enclaves

    def package_files(self, name: str) -> dict[str, bytes]:
        """Return the XML files of a package; empty if there is no such package."""
        return package_files(self.tree, self.workspace.src / name)

    def package(self, name: str) -> Package:
        """Load a package, once per run and content; errors as :meth:`keymint.api.PackageType.load`."""
        files = self.package_files(name)
        key = (name, digest(self.profile_digest, digest_files(files)))
        if key not in self._packages:
            package_type = self.plugins.package_type(self.profile.package_type, self.profile_marker())
            folder = self.workspace.shown(self.workspace.src / name)
            install_space = str(self.workspace.install)
            self._packages[key] = package_type.load(
                self.profile, name, folder, files, self.plugins.build_type, install_space
            )
        return self._packages[key]
