# SPDX-License-Identifier: Apache-2.0
"""A group of verbs imports the verb that is called, and suggests one for a name that is none."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import pytest

from tests.conftest import Outcome


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("autority",), "Error: no verb 'autority' (did you mean 'authority'?)"),
        (("authority", "shwo"), "Error: no verb 'shwo' (did you mean 'show'?)"),
        (("authority", "x"), "Error: no verb 'x' ('keymint authority --help' lists the verbs)"),
    ],
)
def test_a_name_that_is_no_verb(keymint: Callable[..., Outcome], given: tuple[str, ...], said: str) -> None:
    outcome = keymint(*given)
    assert outcome.code == 2
    assert outcome.err.splitlines()[-1] == said


@pytest.mark.parametrize("group", [(), ("authority",)], ids=["verbs", "authority"])
def test_help_imports_no_verb(group: tuple[str, ...]) -> None:
    program = (
        "import sys; from keymint.cli import main; main(sys.argv[1:]);"
        "print(sorted(each for each in sys.modules if each.startswith('keymint.commands.')), file=sys.stderr)"
    )
    command = [sys.executable, "-c", program, *group, "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    imported = ["keymint.commands.life", "keymint.commands.life.authority"] if group else []
    assert done.stderr == f"{imported}\n"
