# SPDX-License-Identifier: Apache-2.0
"""Former names of options work for one release, with a hint; so does the former name of an element of the profile."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import CHECKOUT

FLEET = CHECKOUT / "examples/fleet"
HINT = "use the new name: the next release has no other"


@pytest.mark.parametrize(
    ("former", "now", "named"),
    [
        ("verify -t omg", "verify -i omg", ("-t/--transport", "--implementation")),
        ("verify --transport omg -i fastdds-2.11", "verify -i fastdds-2.11 -i omg", ("-t", "--implementation")),
        ("why /talker publish /chatter -t omg", "why /talker publish /chatter -i omg", ("-t", "--implementation")),
        ("issued talker --accept", "issued talker --tolerate", ("--accept", "--tolerate")),
        (f"graph {FLEET} -f dot", f"graph {FLEET} --format dot", ("-f", "--format")),
        (f"graph {FLEET} -fdot", f"graph {FLEET} --format=dot", ("-f", "--format")),
        (f"diff {FLEET} {FLEET} -f markdown", f"diff {FLEET} {FLEET} --format markdown", ("-f", "--format")),
    ],
)
def test_the_former_name_of_an_option(keymint, ws: Path, former: str, now: str, named: tuple[str, str]) -> None:
    keymint(*now.split(), cwd=ws)  # what it writes is there then
    expected, said = keymint(*now.split(), cwd=ws), keymint(*former.split(), cwd=ws)
    assert (said.code, said.out) == (expected.code, expected.out)
    assert "option-renamed" not in expected.err
    (hint,) = [line for line in said.err.splitlines() if "[option-renamed]" in line]
    assert all(name in hint for name in (*named, HINT))


@pytest.mark.parametrize("words", ["verify -i omg", "why /talker publish /chatter", "import x", "provision x"])
def test_no_help_page_has_a_former_name(keymint, words: str) -> None:
    shown = keymint(words.split(maxsplit=1)[0], "--help").out
    assert not any(name in shown for name in ("--transport NAME  Ask", "-t, ", "--accept"))


def test_a_value_of_a_former_name_is_checked_like_that_of_the_new_one(keymint, ws: Path) -> None:
    for name in ("-t", "-i"):
        outcome = keymint("verify", name, "fastds", cwd=ws)
        assert outcome.code == 2
        assert "did you mean 'fastdds'?" in outcome.err


def test_the_former_name_of_an_element(keymint, ws: Path) -> None:
    profile = ws / "profile/keymint_profile.xml"
    text = profile.read_text()
    profile.write_text(text.replace("</profile>", "<exceptions><open_governance/></exceptions></profile>"))
    assert keymint("build", cwd=ws).err == ""
    profile.write_text(text.replace("</profile>", "<accept><open_governance/></accept></profile>"))
    for _ in range(2):
        outcome = keymint("build", cwd=ws)
        assert outcome.code == 0
        assert "profile/keymint_profile.xml: warning: the element <accept> is called <exceptions> now" in outcome.err
