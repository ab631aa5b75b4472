# SPDX-License-Identifier: Apache-2.0
"""What README and the pages in docs/ show is what happens."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import CHECKOUT, NOW

PAGES = sorted([*CHECKOUT.glob("*.md"), *(CHECKOUT / "docs").rglob("*.md"), *(CHECKOUT / "examples").rglob("*.md")])
README = CHECKOUT / "README.md"


def saved_files(page: Path) -> list[tuple[str, str]]:
    """Return the files that a page asks to save: ``Save this as `name` `` before a block of XML."""
    return re.findall(r"[Ss]ave this as\s+`([\w.]+)`.*?```xml\n(.*?)```", page.read_text(), re.DOTALL)


def test_what_a_robot_that_had_the_keys_of_all_costs(keymint, tmp_path: Path) -> None:
    for name, content in saved_files(README):
        (tmp_path / name).write_text(content)
    assert keymint("provision", "robot.xml", "-w", "ws").code == 0
    page = (CHECKOUT / "docs/keystore-life.md").read_text()
    lines = re.findall(r"`(keymint [^`]*'/\*'[^`]* --yes)`", page)[:2]
    assert len(lines) == 2
    for line in lines:
        assert keymint(*shlex.split(line)[1:], cwd=tmp_path / "ws").code == 0, line
    assert keymint("check", cwd=tmp_path / "ws").code == 0
    assert "opy `install/` to all" not in page


def test_policies_on_all_pages_and_in_the_examples_are_in_canonical_form(keymint, tmp_path: Path) -> None:
    blocks = [block for page in PAGES for block in re.findall(r"```xml\n(.*?)```", page.read_text(), re.DOTALL)]
    shown = [block for block in blocks if re.match(r"(<\?xml.*\n)?<(profiles?|tests)\b", block)]
    assert len(shown) >= 6
    for number, block in enumerate(shown):
        (tmp_path / f"shown{number}.xml").write_text(block)
    outcome = keymint("fmt", "--check", str(tmp_path), str(CHECKOUT / "examples"))
    assert (outcome.code, outcome.err) == (0, ""), outcome.err


def test_the_policy_on_the_page_of_the_language_works_when_saved(keymint, tmp_path: Path) -> None:
    files = saved_files(CHECKOUT / "docs" / "language.md")
    assert [name for name, _ in files] == ["policy.xml", "policy.test.xml"]
    for name, content in files:
        (tmp_path / name).write_text(content)
    outcome = keymint("provision", "policy.xml", "-w", "ws", cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    document = (tmp_path / "ws/install/enclaves/robot1/camera/permissions.xml").read_text()
    assert "<topic>rt/robot1/image*</topic>" in document
    outcome = keymint("test", "policy.xml", "--min-coverage", "90", cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    assert "3 of 3 expectations hold; 2 of 2 rules are exercised" in outcome.out


def test_every_verb_that_readme_names_exists(keymint) -> None:
    for verb in set(re.findall(r"`?keymint ([a-z]+)", README.read_text())):
        assert keymint(verb, "--help").code == 0, verb


def test_the_picture_of_the_fleet_is_what_keymint_draws(keymint, tmp_path: Path) -> None:
    outcome = keymint("graph", "examples/fleet", "-o", str(tmp_path / "fleet.svg"), cwd=CHECKOUT)
    assert outcome.code == 0, outcome.err
    committed = CHECKOUT / "docs" / "images" / "fleet.svg"
    assert (tmp_path / "fleet.svg").read_text() == committed.read_text(), (
        f"draw it again: SOURCE_DATE_EPOCH={NOW} keymint graph examples/fleet -o docs/images/fleet.svg"
    )


def links(page: Path) -> Iterator[str]:
    """Yield the targets of a page's links to other files."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)|(?:src|srcset)=\"([^\"]+)\"", text):
        path = (target[0] or target[1]).partition("#")[0]
        if path and "://" not in path:
            yield path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: os.path.relpath(page, CHECKOUT))
def test_every_link_leads_to_a_file(page: Path) -> None:
    """The build of the site checks links to its generated pages, which are not in the repository."""
    written = [link for link in links(page) if "reference/generated/" not in link]
    assert [link for link in written if not (page.parent / link).exists()] == []
