# SPDX-License-Identifier: Apache-2.0
"""Which symbolic links are followed: relative ones, within a folder, to a file that everyone may read."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.view.file_reading import linked_file, read_file
from keymint.view.tree import Tree


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "install"
    (folder / "enclave").mkdir(parents=True)
    (folder / "public").write_text("public")
    (folder / "secret").write_text("secret")
    (folder / "secret").chmod(0o600)
    (tmp_path / "outside").write_text("outside")
    return folder


@pytest.mark.parametrize(
    ("target", "followed"),
    [
        ("../public", True), ("../secret", False), ("../../outside", False), ("../nothing", False), ("..", False),
        ("ABSOLUTE", False), ("link", False),
    ],
)  # fmt: skip
def test_links(folder: Path, target: str, followed: bool) -> None:
    link = folder / "enclave/link"
    link.symlink_to(folder / "public" if target == "ABSOLUTE" else target)
    assert linked_file(str(link), str(folder)) == (str(folder / "public") if followed else "")
    assert linked_file(str(link), "") == ""
    tree = Tree(linked=folder)
    assert tree.try_read(link) == (b"public" if followed else None)
    assert tree.follows(link) == (str(folder / "public") if followed else "")
    assert tree.has_file(link) is followed
    held = Tree(linked=folder)
    held.hold(folder)
    assert held.try_read(link) == (b"public" if followed else None)
    assert Tree().try_read(link) is None


def test_a_link_by_way_of_another_one_leads_where_that_leads(folder: Path, tmp_path: Path) -> None:
    (folder / "enclave/way").symlink_to("../../outside")
    (folder / "enclave/link").symlink_to("way")
    assert linked_file(str(folder / "enclave/link"), str(folder)) == ""


def test_a_file_is_read_without_a_link_on_its_way(folder: Path) -> None:
    assert read_file(folder / "public") == b"public"
    assert read_file(folder / "none") is None
