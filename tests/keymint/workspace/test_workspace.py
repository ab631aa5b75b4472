# SPDX-License-Identifier: Apache-2.0
"""Where a workspace and its packages are, and where they must not be."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from keymint import SPACES
from keymint.errors import ExitCode, KeymintError
from keymint.view.tree import Tree
from keymint.workspace.workspace import Workspace, find, package_paths, packages, shown_path


def make(root: Path, *paths: str) -> Path:
    for path in paths:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_bytes(path.encode())
    return root


def test_the_spaces_lie_in_the_root_unless_an_option_says_otherwise(tmp_path: Path) -> None:
    workspace = Workspace.at(tmp_path, {"install": Path("/opt/keys"), "build": Path("../out")}, tmp_path)
    assert workspace.profile == tmp_path / "profile"
    assert workspace.install == Path("/opt/keys")
    assert workspace.build == tmp_path.parent / "out"


def test_the_root_may_be_reached_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    assert Workspace.at(tmp_path / "link", {}, tmp_path).src == tmp_path / "real" / "src"


def test_a_space_that_is_a_link_is_left_for_the_store_to_refuse(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "install").symlink_to("elsewhere")
    assert Workspace.at(tmp_path, {}, tmp_path).install == tmp_path / "install"
    # One that is named by its option is what the user wants, wherever it leads.
    assert Workspace.at(tmp_path, {"install": Path("install")}, tmp_path).install == tmp_path / "elsewhere"


@pytest.mark.parametrize(
    "spaces",
    [
        {"install": Path("private")},
        {"install": Path("private/out")},
        {"private": Path("install/keys")},
        {"build": Path("src/../install/x")},
        {"build": Path("/")},
        {"src": Path()},
    ],
)
def test_spaces_that_overlap_are_refused(tmp_path: Path, spaces: dict[str, Path]) -> None:
    with pytest.raises(KeymintError) as caught:
        Workspace.at(tmp_path, spaces, tmp_path)
    assert caught.value.diagnostics[0].code == "space-overlap"
    assert caught.value.exit_code == ExitCode.USAGE


def test_an_overlap_through_a_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "private").mkdir()
    (tmp_path / "link").symlink_to("private")
    with pytest.raises(KeymintError):
        Workspace.at(tmp_path, {"install": Path("link")}, tmp_path)


def test_a_workspace_is_found_upward(tmp_path: Path) -> None:
    make(tmp_path, "ws/profile/keymint_profile.xml", "ws/src/a/b/keymint_package.xml", "ws/src/profile/other.xml")
    for start in ("ws", "ws/src", "ws/src/a/b", "ws/profile"):
        assert find(tmp_path / start, {}, tmp_path).root == tmp_path / "ws"
    with pytest.raises(KeymintError) as caught:
        find(tmp_path, {}, tmp_path)
    assert caught.value.diagnostics[0].code == "workspace-missing"
    assert "keymint init" in caught.value.diagnostics[0].help


def test_the_inner_of_two_workspaces_is_found(tmp_path: Path) -> None:
    make(tmp_path, "profile/keymint_profile.xml", "inner/profile/keymint_profile.xml")
    assert find(tmp_path / "inner" / "profile", {}, tmp_path).root == tmp_path / "inner"


def test_packages_are_nested_and_ignored_folders_are_not_searched(tmp_path: Path) -> None:
    make(
        tmp_path,
        "robot1/keymint_package.xml",
        "robot1/arm/driver/keymint_package.xml",
        "talker/keymint_package.xml",
        "talker/permissions.xml",
        "talker/package.defaults/keymint_package.xml",
        "no_package/permissions.xml",
        "ignored/KEYMINT_IGNORE",
        "ignored/keymint_package.xml",
        "ignored/below/keymint_package.xml",
        ".hidden/keymint_package.xml",
        "keymint_package.xml",
    )
    (tmp_path / "loop").symlink_to(tmp_path)
    (tmp_path / "folder" / "keymint_package.xml").mkdir(parents=True)
    assert packages(Tree(), tmp_path) == ("robot1", "robot1/arm/driver", "talker")


def test_packages_that_are_planned_are_seen(tmp_path: Path) -> None:
    make(tmp_path, "a/keymint_package.xml")
    planned = {tmp_path / "b" / "c": {"keymint_package.xml": b""}, tmp_path / "a": {"keymint_package.xml": None}}
    assert packages(Tree().overlaid(planned.items()), tmp_path) == ("b/c",)


@pytest.mark.parametrize("folder", ["1st", "a-b", "a b", "talker.bak", "ä"])
def test_a_package_whose_folder_is_no_legal_name_is_refused(tmp_path: Path, folder: str) -> None:
    make(tmp_path, f"{folder}/keymint_package.xml")
    with pytest.raises(KeymintError) as caught:
        packages(Tree(), tmp_path)
    assert caught.value.diagnostics[0].code == "name-illegal"


def test_no_source_space_has_no_packages(tmp_path: Path) -> None:
    assert packages(Tree(), tmp_path / "missing") == ()


def test_the_files_of_a_package(tmp_path: Path) -> None:
    make(
        tmp_path,
        "src/a/permissions.xml",
        "src/a/notes.txt",
        "src/a/package.defaults/governance.xml",
        "src/a/b/permissions.xml",
    )
    workspace = Workspace.at(tmp_path, {}, tmp_path)
    assert set(package_paths(Tree(), workspace, "a")) == {"permissions.xml", "package.defaults/governance.xml"}


def test_paths_are_shown_as_a_user_would_type_them() -> None:
    start = Path("/home/me/ws")
    assert shown_path(start / "src" / "a", start) == "src/a"
    assert shown_path(Path("/home/me/policy"), start) == "../policy"
    assert shown_path(Path("/opt/keys"), start) == "/opt/keys"


def test_where_keys_and_certificates_lie(tmp_path: Path) -> None:
    workspace = Workspace.at(tmp_path, {}, tmp_path)
    assert set(SPACES) == {path.name for path in map(workspace.__getattribute__, SPACES)}
    assert workspace.authority_key("ca").is_relative_to(workspace.private)
    assert Path(workspace.identity_key("a/b")).is_relative_to(workspace.private)
    assert workspace.authority_certificate("ca").is_relative_to(workspace.public)
    # No name of a package or an authority leads one key onto another.
    assert Path(workspace.identity_key("identities")) != workspace.authority_key("identities/key")
    assert workspace.state == tmp_path / ".keymint"


@pytest.mark.parametrize(
    "path", ["/srv/robots/ws", "/srv/robots", "/srv", "/srv/robots/ws2/a", "/srv/robots/w", "/srv/other"]
)
def test_a_path_is_shown_as_the_system_relates_it(path: str) -> None:
    start = Path("/srv/robots/ws")
    assert shown_path(Path(path), start) == os.path.relpath(path, start)
