"""What README shows is what happens."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from tests.conftest import CHECKOUT

CLOCK = "1795219200"  # 2026-11-21T00:00:00Z, when the tour was written


def tour() -> list[tuple[str, str]]:
    """Return the commands of the tour, each with the output that README shows."""
    text = (CHECKOUT / "README.md").read_text()
    steps: list[tuple[str, str]] = []
    for block in re.findall(r"```console\n(.*?)```", text, re.DOTALL):
        for part in block.split("$ ")[1:]:
            command, _, output = part.partition("\n")
            steps.append((command, output))
    return steps


def test_the_tour_of_the_four_stages(keymint, tmp_path: Path) -> None:
    folder = tmp_path
    shown = 0
    for command, output in tour():
        words = shlex.split(command)
        if words[0] == "cd":
            folder /= words[1]
            continue
        assert words[0] == "keymint"
        outcome = keymint(*words[1:], cwd=folder, env={"SOURCE_DATE_EPOCH": CLOCK})
        assert outcome.code == 0, outcome.err
        assert outcome.out == output
        shown += 1
    assert shown >= 8


def test_the_example_of_the_language_is_a_policy(keymint, tmp_path: Path) -> None:
    text = (CHECKOUT / "README.md").read_text()
    [example] = re.findall(r"```xml\n(<profiles.*?)```", text, re.DOTALL)
    (tmp_path / "policy.xml").write_text(example)
    outcome = keymint("provision", "policy.xml", "-w", "ws")
    assert outcome.code == 0, outcome.err
    document = (tmp_path / "ws/install/enclaves/robot1/camera/permissions.xml").read_text()
    assert "<topic>rt/robot1/image*</topic>" in document


def test_every_verb_and_option_that_readme_names_exists(keymint) -> None:
    text = (CHECKOUT / "README.md").read_text()
    for verb in set(re.findall(r"`?keymint ([a-z]+)", text)):
        assert keymint(verb, "--help").code == 0, verb
