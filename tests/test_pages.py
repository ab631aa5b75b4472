# SPDX-License-Identifier: Apache-2.0
"""Whoever follows README, a tutorial or another page from an empty folder sees what the page shows."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from keymint_ros2_dds.discovery import graph_source

from tests import pages
from tests.pages import CHECKOUT, Reader, changed, is_shown, masked, steps_of
from tests.softhsm import SoftHsm
from tests.stand_ins import STAND_INS

DOCS = CHECKOUT / "docs"
WRITTEN_TO_BE_FOLLOWED = sorted([*(DOCS / "tutorials").glob("*.md"), *(DOCS / "how-to").glob("*.md")])
"""Pages on which each command is one that runs, or is marked with what it needs."""
NEEDS_TOKEN = DOCS / "how-to" / "hsm.md"
FOLLOWED = [
    CHECKOUT / "README.md",
    DOCS / "audit.md",
    DOCS / "ci.md",
    DOCS / "keystore-life.md",
    DOCS / "sros2.md",
    DOCS / "explanation" / "proof.md",
    *(page for page in WRITTEN_TO_BE_FOLLOWED if page != NEEDS_TOKEN),
]


def name_of(page: Path) -> str:
    return os.path.relpath(page, CHECKOUT)


def page_to_follow(page: Path) -> pytest.ParameterSet:
    """Return a page, marked if its reader needs real DDS software."""
    marks = [pytest.mark.cyclonedds] if pages.NOW in page.read_text() else []
    return pytest.param(page, id=name_of(page), marks=marks)


@pytest.mark.parametrize("page", [page_to_follow(page) for page in FOLLOWED])
def test_a_page_shows_what_its_reader_sees(page: Path, tmp_path: Path) -> None:
    if pages.NOW in page.read_text() and not (usable := graph_source.usable()).usable:
        message = f"{usable.reason}; {usable.help}"
        if os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
            pytest.fail(message, pytrace=False)
        pytest.skip(message)
    follow_and_compare(page, tmp_path)


@pytest.mark.softhsm
def test_the_page_about_tokens_shows_what_its_reader_sees(softhsm: SoftHsm, tmp_path: Path) -> None:
    """The reader makes a token of their own; the fixture is there where the software for it is."""
    assert softhsm.label
    follow_and_compare(NEEDS_TOKEN, tmp_path)


def follow_and_compare(page: Path, tmp_path: Path) -> None:
    (tmp_path / "reader").mkdir()
    with Reader(tmp_path / "reader", STAND_INS) as reader:
        printed = list(reader.follow(page))
    text = page.read_text()
    for step, output in printed:
        assert is_shown(output, step.content, text), (
            f"{name_of(page)}:{step.line}: $ {step.what}\n{output}\n"
            f"if this is right: .venv/bin/python -m tests.pages {name_of(page)}"
        )
    for picture, drawn in pages.drawings(page, tmp_path / "reader"):
        assert masked(drawn.read_text(), text) == masked(picture.read_text(), text), (
            f"{picture.name} is not what the page draws"
        )
    assert printed


@pytest.mark.parametrize("page", WRITTEN_TO_BE_FOLLOWED, ids=name_of)
def test_each_command_of_a_page_is_in_a_block_that_is_run(page: Path) -> None:
    """Blocks in other languages are files or excerpts; blocks without a language are none of both."""
    found = re.findall(r"^```(\w*)[^\n]*\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    assert [block for language, block in found if language in {"", "bash", "sh", "shell"}] == []
    assert re.findall(r"^ +```console", page.read_text(), re.MULTILINE) == [], "an indented block is not run"


def test_files_are_saved_changed_and_appended_to_at_their_place(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "Save this as `one/a.txt`:\n\n```text\nfirst\nsecond\n```\n\n"
        "```console\n$ cat one/a.txt\nfirst\nsecond\n$ cd one\n```\n\n"
        "Change `a.txt`, so that it is better:\n\n```diff\n-second\n+2\n```\n\n"
        "Append this to `a.txt`:\n\n```text\nthird\n```\n\nA block that is only shown:\n\n```text\nnothing\n```\n\n"
        "```console\n$ cat a.txt && echo \\\n>   $PWD\n```\n"
    )
    with Reader(tmp_path) as reader:
        printed = list(reader.follow(page))
    assert [output for _, output in printed] == ["first\nsecond\n", "", "first\n2\nthird\n~/one\n"]
    assert pages.rewritten(page, printed).endswith(">   $PWD\nfirst\n2\nthird\n~/one\n```\n")


def test_a_page_may_start_where_another_one_ends_and_set_the_clock(tmp_path: Path) -> None:
    (tmp_path / "first.md").write_text("```console\n$ mkdir ws\n$ cd ws\n```\n")
    (tmp_path / "then.md").write_text(
        "<!-- starts where: first.md ends -->\n\n<!-- clock: 2027-01-15T08:00:00Z -->\n\n"
        "```console\n$ pwd\n$ echo $SOURCE_DATE_EPOCH\n```\n"
    )
    with Reader(tmp_path) as reader:
        assert [output for _, output in reader.follow(tmp_path / "then.md")] == ["~/ws\n", "1800000000\n"]


def test_a_command_that_fails_must_be_shown_to_fail(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```console\n$ false\n$ echo $?\n1\n$ ls nothing && ls\nx: error: no file\n```\n")
    with Reader(tmp_path) as reader:
        assert [output for _, output in reader.follow(page)][:2] == ["", "1\n"]
    page.write_text("```console\n$ false\n```\n")
    with Reader(tmp_path) as reader, pytest.raises(AssertionError, match=r"page\.md:2: exit code 1"):
        list(reader.follow(page))


def test_what_needs_ros_is_not_run_but_may_have_a_stand_in(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```console\n$ ros2 security create   # needs ROS 2\nmade\n$ ros2 x  # needs ROS 2\n$ cat made\n```\n"
    )
    stand_ins = {"ros2 security create": "echo by the stand-in >made"}
    with Reader(tmp_path, stand_ins) as reader:
        assert [output for _, output in reader.follow(page)] == ["by the stand-in\n"]
    assert [step.not_run for step in steps_of(page.read_text())] == [True, True, False]


@pytest.mark.parametrize(
    ("printed", "shown", "same"),
    [
        ("a\nb\nc\n", "a\n…\nc\n", True),
        ("a\nc\n", "a\n…\n", True),
        ("a\nb\nc\n", "a\n…\nb\n", False),
        ("serial 3fd1aa00bb, 2 of 3\n", "serial 99887766aa, 2 of 3\n", True),
        ("serial 3fd1aa00bb, 2 of 3\n", "serial 99887766aa, 3 of 3\n", False),
        ("digest 0f:1e:2d:3c:4b:5a:69:78\n", "digest AA:BB:CC:DD:EE:FF:00:11\n", True),
        ("/a  0  99887766aa    in force\n", "/a  0  1f99887766aabb  in force\n", True),
        ("OU = 3fd1aa00bb, CN = /a\n", "OU=99887766aa, CN=/a\n", True),
        ("12 files in 0.31 s\n", "12 files in 4 s\n", True),
        ("until 2027-11-20\n", "until 2027-11-21\n", False),
        ("from 2027-11-20 on\n", "from … on\n", True),
    ],
)
def test_only_what_differs_each_time_is_masked(printed: str, shown: str, same: bool) -> None:
    assert is_shown(printed, shown) == same


def test_a_change_must_fit_once() -> None:
    assert changed("a\nb\nc\n", " a\n+x\n@@ further down @@\n-c\n", "here") == "a\nx\nb\n"
    with pytest.raises(AssertionError, match="here: 2 times"):
        changed("a\na\n", "-a\n", "here")
