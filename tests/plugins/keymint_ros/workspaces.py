# SPDX-License-Identifier: Apache-2.0
"""A bootstrapped profile and a package of it, as files in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from keymint_ros import package_type, profile_type

from comarmor.errors import Diagnostic, Origin
from comarmor.rules import Effect
from keymint.api import Bootstrap, Package, WorkspaceProfile
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules
from tests.conftest import installed_plugins

NOW = datetime(2026, 11, 21, 15, 30, tzinfo=UTC)
ROOT = Path("/ws/profile")
REFERENCE = Path(__file__).resolve().parents[4] / "shared" / "reference" / "ppac" / "keymint_ws"

REQUEST = Bootstrap(name="demo", policy="", distro="jazzy", domain=0, layout="sros2", subject_format="unique", now=NOW)

RULES = SubjectRules(
    "/robot1/talker",
    (
        Rule(
            Effect.ALLOW,
            "ros_topic",
            ("ros_publish",),
            ("/robot1/chatter",),
            (),
            audit=False,
            origin=Origin("/ws/profile/comarmor.d/common/x.xml", 3, (Origin("/ws/profile/comarmor.d/a.xml", 9),)),
        ),
        Rule(
            Effect.DENY,
            "topic",
            ("publish", "subscribe"),
            ("rt/a*", "rt/b"),
            ("", "p*"),
            audit=True,
            origin=Origin("/elsewhere/policy.xml", 12),
        ),
    ),
)


def rules(*expressions: str, line: int = 1) -> SubjectRules:
    """Return the rules of another policy: one rule with these expressions."""
    origin = Origin("/ws/profile/comarmor.d/b.xml", line)
    rule = Rule(Effect.ALLOW, "ros_topic", ("ros_publish",), expressions, (), audit=False, origin=origin)
    return SubjectRules("/robot1/talker", (rule,))


@dataclass(frozen=True)
class Workspace:
    """A profile and a package of it.

    Attributes:
        profile: files of the profile space.
        package: files of the package.
        name: the package's name.
    """

    profile: Mapping[str, bytes]
    package: Mapping[str, bytes]
    name: str = "robot1/talker"

    @classmethod
    def new(cls, request: Bootstrap = REQUEST) -> Workspace:
        """Bootstrap a profile, and create a package."""
        files = profile_type.bootstrap(request)
        profile = profile_type.load(ROOT, files)
        return cls(files, package_type.create(profile, RULES, {}, force=False))

    def edit(self, path: str, old: str, new: str) -> Workspace:
        """Replace the first occurrence of a text in a file of the profile (``profile/…``) or the package."""
        space, files = ("profile", self.profile) if path.startswith("profile/") else ("package", self.package)
        key = path.removeprefix("profile/")
        text = files[key].decode()
        assert old in text
        return replace(self, **{space: {**files, key: text.replace(old, new, 1).encode()}})

    def without(self, path: str) -> Workspace:
        """Remove a file."""
        space, files = ("profile", self.profile) if path.startswith("profile/") else ("package", self.package)
        key = path.removeprefix("profile/")
        assert key in files
        return replace(self, **{space: {name: content for name, content in files.items() if name != key}})

    def load_profile(self) -> WorkspaceProfile:
        return profile_type.load(ROOT, self.profile)

    def load(self) -> Package:
        return load_package(self.load_profile(), self.name, f"src/{self.name}", self.package)

    def create(self, new_rules: SubjectRules, *, force: bool = False) -> Mapping[str, bytes]:
        return package_type.create(self.load_profile(), new_rules, self.package, force=force)


def load_package(profile: WorkspaceProfile, name: str, folder: str, files: Mapping[str, bytes]) -> Package:
    """Load a package with the installed build types."""
    return package_type.load(profile, name, folder, files, installed_plugins().build_type, "/ws/install")


def diagnostic_of(attempt: Callable[[], object], file: str) -> Diagnostic:
    """Return the first diagnostic of a call that fails; it must be one line, with a place in ``file``."""
    with pytest.raises(KeymintError) as error:
        attempt()
    diagnostic = error.value.diagnostics[0]
    assert diagnostic.where
    assert diagnostic.where.file == file
    assert diagnostic.where.line > 0
    assert "\n" not in str(diagnostic)
    return diagnostic


def read_folder(folder: Path) -> dict[str, bytes]:
    """Return the XML files below a folder by relative path."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*.xml"))}


def write_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files below a folder."""
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
