# SPDX-License-Identifier: Apache-2.0
"""Differences that patch applies, whatever characters and line ends a file has."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from keymint.commands.understand.fmt import file_diff, first_difference

CONTENTS = st.lists(st.sampled_from([b"a\n", b"b\r\n", b"\x0c\xc2\x85\n", b"\xff", b"\n", b"c"]), max_size=6).map(
    b"".join
)


@pytest.mark.parametrize(
    ("before", "after"),
    [(b"a\nb", b"a\nb\n"), (b"a\r\nb\r\n", b"a\nb\n"), (b"\xe9\x0c\x1c x\n", "é\u2028\n".encode()), (b"", b"a\n")],
)
def test_patch_applies_it(tmp_path: Path, before: bytes, after: bytes) -> None:
    (tmp_path / "f").write_bytes(before)
    diff = file_diff("f", before, after)
    subprocess.run(["git", "apply", "-"], input=diff, cwd=tmp_path, check=True)
    assert (tmp_path / "f").read_bytes() == after


@given(CONTENTS, CONTENTS)
def test_the_first_line_that_differs(before: bytes, after: bytes) -> None:
    line = first_difference(before, after)
    assert (line == 0) == (before == after) == (file_diff("f", before, after) == b"")
    old, new = before.split(b"\n"), after.split(b"\n")
    assert old[: max(line - 1, 0)] == new[: max(line - 1, 0)]
    assert line == 0 or old[line - 1 : line] != new[line - 1 : line] or len(old) != len(new)


def test_an_absolute_path_is_below_the_root() -> None:
    assert file_diff("/tmp/f", b"a\n", b"b\n").startswith(b"--- a/tmp/f\n+++ b/tmp/f\n")
