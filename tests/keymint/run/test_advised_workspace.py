# SPDX-License-Identifier: Apache-2.0
"""Commands that a message advises work as they are: they name the workspace that the user named."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import click
import pytest

from keymint.cli import cli
from keymint.run.run import WITHOUT_WORKSPACE


@pytest.mark.parametrize(
    ("named", "advised"),
    [(("-w", "ws"), " -w ws"), (("-w", "a b"), ' -w "a b"'), (("-w", "."), ""), ((), "")],
    ids=" ".join,
)
def test_the_workspace_is_named_as_the_user_named_it(
    keymint: Callable, provisioned: Path, named: tuple[str, ...], advised: str
) -> None:
    (provisioned.parent / "a b").symlink_to("ws")
    shutil.rmtree(provisioned / "install/enclaves/talker")
    outcome = keymint("check", *named, cwd=provisioned if advised == "" else provisioned.parent)
    assert re.findall("'(keymint install talker[^']*)'", outcome.err) == [f"keymint install talker{advised}"]


def test_verbs_without_a_workspace_are_known() -> None:
    context = click.Context(cli)
    verbs = {name: cli.get_command(context, name) for name in cli.list_commands(context)}
    without = {
        name
        for name, verb in verbs.items()
        if verb and not isinstance(verb, click.Group) and "workspace" not in {each.name for each in verb.params}
    }
    assert sorted(without) == WITHOUT_WORKSPACE.split("|")
