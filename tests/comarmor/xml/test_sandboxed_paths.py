# SPDX-License-Identifier: Apache-2.0
"""Access to files stays inside a folder, and reads are bounded."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from comarmor.errors import ComArmorError, Origin
from comarmor.xml.sandboxed_paths import SandboxedFolder, path_text, read_bounded, read_failure

HERE = Origin("p.xml", 1)


@pytest.fixture
def sandbox(tmp_path: Path) -> SandboxedFolder:
    """Return a folder with ``a.xml`` and ``sub/b.xml``; ``outside.xml`` is beside it."""
    folder = tmp_path / "policy"
    (folder / "sub").mkdir(parents=True)
    (folder / "a.xml").write_text("a")
    (folder / "sub" / "b.xml").write_text("bbb")
    (tmp_path / "outside.xml").write_text("secret")
    return SandboxedFolder(folder.resolve(), "policy")


@pytest.mark.parametrize(
    "relative", ["../outside.xml", "sub/../../outside.xml", "/etc/passwd", "link.xml", "dir/x", ".."]
)
def test_paths_that_lead_outside_are_refused(sandbox: SandboxedFolder, tmp_path: Path, relative: str) -> None:
    (sandbox.real / "link.xml").symlink_to(tmp_path / "outside.xml")
    (sandbox.real / "dir").symlink_to(tmp_path)
    for access in (sandbox.resolve, sandbox.find):
        with pytest.raises(ComArmorError) as caught:
            access(relative, HERE)
        (diagnostic,) = caught.value.diagnostics
        assert (diagnostic.code, diagnostic.where) == ("include-outside", HERE)
        assert "'policy'" in diagnostic.message


def test_paths_that_come_back_inside_are_allowed_unless_they_begin_outside(sandbox: SandboxedFolder) -> None:
    assert sandbox.resolve("sub/../a.xml", HERE) == sandbox.real / "a.xml"
    with pytest.raises(ComArmorError, match="outside"):
        sandbox.resolve("../policy/a.xml", HERE)


def test_files_that_exist_and_those_that_do_not(sandbox: SandboxedFolder) -> None:
    assert sandbox.find("sub/b.xml", HERE)
    for missing in ("c.xml", "a.xml/c.xml", "none/c.xml"):
        assert sandbox.find(missing, HERE) is None
    with pytest.raises(ComArmorError, match="cannot be read"):
        sandbox.find("x" * 5000, HERE)


def test_a_read_is_bounded(sandbox: SandboxedFolder) -> None:
    assert read_bounded(sandbox.real, sandbox.real / "sub" / "b.xml", 2) == b"bb"
    assert read_bounded(sandbox.real, sandbox.real / "sub" / "b.xml", 10) == b"bbb"


@pytest.mark.parametrize("part", ["sub", "sub/b.xml"])
def test_a_path_that_is_swapped_for_a_link_after_the_check_is_not_followed(
    sandbox: SandboxedFolder, tmp_path: Path, part: str
) -> None:
    checked = sandbox.resolve("sub/b.xml", HERE)
    (tmp_path / "b.xml").write_text("secret")
    (sandbox.real / part).rename(tmp_path / "moved")
    (sandbox.real / part).symlink_to(tmp_path if part == "sub" else tmp_path / "b.xml")
    with pytest.raises(OSError, match=r"symbolic links|Not a directory"):
        read_bounded(sandbox.real, checked, 10)


def test_only_regular_files_are_read_and_a_pipe_does_not_block(sandbox: SandboxedFolder) -> None:
    os.mkfifo(sandbox.real / "pipe")
    for name, reason in (("pipe", "not a regular file"), ("sub", "Is a directory")):
        with pytest.raises(OSError, match=reason):
            read_bounded(sandbox.real, sandbox.real / name, 10)


def test_a_missing_file_is_compared_with_those_in_its_folder(sandbox: SandboxedFolder) -> None:
    (sandbox.real / "sub" / "b.xml").rename(sandbox.real / "sub" / "node.xml")
    assert sandbox.similar_file("sub/nod.xml") == "did you mean 'node.xml'?"
    assert sandbox.similar_file("sub/nod.xml", including="policy/sub/node.xml") == ""
    assert sandbox.similar_file("none/nod.xml") == ""


def test_names_as_the_user_would_type_them(sandbox: SandboxedFolder) -> None:
    assert sandbox.name("sub/b.xml") == "policy/sub/b.xml"
    assert SandboxedFolder(sandbox.real, ".").name("a.xml") == "a.xml"
    assert path_text(os.fsdecode(b"p\xff/\xc3\xa9")) == "p\\xff/é"


def test_reasons_why_a_file_cannot_be_read() -> None:
    assert read_failure(FileNotFoundError(2, "No such file"), "the file") == "the file does not exist"
    assert read_failure(PermissionError(13, "Permission denied"), "it") == "it cannot be read: Permission denied"
    assert read_failure(ValueError("embedded null byte"), "it") == "it cannot be read: embedded null byte"


def test_no_file_stays_open(sandbox: SandboxedFolder) -> None:
    (sandbox.real / "link.xml").symlink_to("a.xml")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for name in ("a.xml", "sub/b.xml", "sub", "link.xml", "none.xml", "none/b.xml"):
        try:
            read_bounded(sandbox.real, sandbox.real / name, 10)
        except OSError:
            continue
    assert len(list(Path("/proc/self/fd").iterdir())) == before
