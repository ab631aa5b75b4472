# SPDX-License-Identifier: Apache-2.0
"""Scripts and exports, read by real shells. A missing one skips, or fails with ``KEYMINT_REQUIRE_VENDORS=1``."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from keymint.api import EnvironmentVariable
from keymint.stages.environment_scripts import SHELLS, exports, script, variable_values
from keymint.workspace.installed_enclaves import is_script

VARIABLES = (
    EnvironmentVariable("KEYSTORE", "", is_path=True),
    EnvironmentVariable("BELOW", "a b/it's", is_path=True),
    EnvironmentVariable("SWITCH", "true"),
)
FOLDERS = ("plain", "with blanks", "q'uo\"te", "$x `id` {a,b} *~ ü %n \\é", "tab\tand\nline")
STRICT = {"bash": "set -euo pipefail; ", "zsh": "setopt ERR_EXIT NO_UNSET KSH_ARRAYS SH_WORD_SPLIT POSIX_ARGZERO; "}
"""Options under which scripts are sourced as well."""


@pytest.fixture(params=SHELLS)
def shell(request: pytest.FixtureRequest) -> str:
    if shutil.which(request.param) is None:
        if os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
            pytest.fail(f"KEYMINT_REQUIRE_VENDORS=1, but there is no {request.param}", pytrace=False)
        pytest.skip(f"there is no {request.param}")
    return request.param


def seen(shell: str, commands: str, cwd: Path) -> dict[str, str]:
    """Return the environment of a process that a shell starts after some commands."""
    options = {"bash": ("--norc",), "zsh": ("-f",), "fish": ("--no-config",)}[shell]
    environment = {"PATH": os.environ["PATH"], "HOME": str(cwd), "LC_ALL": "C"}
    done = subprocess.run(
        [shell, *options, "-c", f"{commands}\nenv -0"], cwd=cwd, env=environment, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    return dict(entry.split("=", 1) for entry in os.fsdecode(done.stdout).split("\0") if entry)


@pytest.mark.parametrize("name", FOLDERS)
def test_a_script_finds_its_folder(shell: str, name: str, tmp_path: Path) -> None:
    keystore = tmp_path / name
    keystore.mkdir()
    content = script(VARIABLES, shell)
    assert is_script(content)
    (keystore / f"keystore.{shell}").write_bytes(content)
    (tmp_path / f"link.{shell}").symlink_to(keystore / f"keystore.{shell}")
    (tmp_path / "folder").symlink_to(keystore)
    expected = {"KEYSTORE": str(keystore), "BELOW": f"{keystore}/a b/it's", "SWITCH": "true"}
    by_link = f"source ./link.{shell}; cd /", tmp_path
    by_folder = f"source folder/keystore.{shell}", tmp_path
    beside = f"{STRICT.get(shell, '')}source ./keystore.{shell}", keystore
    absolute = f"source {SHELLS[shell].quoted(str(keystore / f'keystore.{shell}'))}", tmp_path
    for commands, cwd in (by_link, by_folder, beside, absolute):
        found = seen(shell, commands, cwd)
        assert {each: found[each] for each in expected} == expected
        assert not [each for each in found if "keymint" in each]


def test_nothing_but_the_variables_stays(shell: str, tmp_path: Path) -> None:
    (tmp_path / "s").write_bytes(script(VARIABLES, shell))
    names = {"bash": "compgen -v", "zsh": "print -l ${(k)parameters}", "fish": "set --names"}[shell]
    seen(shell, f"{names} > before\nsource ./s\n{names} > after", tmp_path)
    before, after = (set((tmp_path / each).read_text().split()) for each in ("before", "after"))
    assert {each.name for each in VARIABLES} <= after
    assert not [each for each in after - before if "keymint" in each]


@pytest.mark.parametrize(
    "value", ["/plain", "", "a b", "it's", "''", '"$HOME" `id` \\n \\', "=ls", "~", "-n", "a\nb", "é"]
)
def test_exports_keep_every_value(shell: str, value: str, tmp_path: Path) -> None:
    (tmp_path / "lines").write_text(exports({"FIRST": value, "SECOND": "x"}, shell))
    command = "cat lines | source" if shell == "fish" else 'eval "$(cat lines)"'
    found = seen(shell, command, tmp_path)
    assert (found["FIRST"], found["SECOND"]) == (value, "x")


def test_paths_are_below_the_keystore() -> None:
    values = variable_values(VARIABLES, Path("/k"))
    assert values == {"KEYSTORE": "/k", "BELOW": "/k/a b/it's", "SWITCH": "true"}


@given(st.text(st.sampled_from("aZ09_./:+-é\u0660\n ~$"), max_size=4))
def test_words_that_mean_nothing_to_a_shell_are_not_quoted(word: str) -> None:
    is_plain = re.fullmatch(r"[A-Za-z0-9_./][A-Za-z0-9_./:+-]*", word) is not None
    assert {shell.quoted(word) == word for shell in SHELLS.values()} == {is_plain}
