# SPDX-License-Identifier: Apache-2.0
"""Defaults of options: which may be set, where, which one is stronger, and what is refused with its line."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import click
import pytest

from keymint import cli as command_line
from keymint.cli import cli
from keymint.command_line.defaults import MAX_BYTES, SETTINGS


def commands(group: click.Group = cli, path: tuple[str, ...] = ()) -> Mapping[tuple[str, ...], click.Command]:
    """Return all verbs by their words."""
    found: dict[tuple[str, ...], click.Command] = {}
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            found |= commands(command, (*path, name))
        elif command is not None:
            found[*path, name] = command
    return found


def test_the_variables_that_are_looked_at_are_those_of_the_settings() -> None:
    """They stand apart, so that a run without any of them does not load what reads them."""
    assert {key.upper() for key in SETTINGS} == command_line._DEFAULTS


@pytest.mark.parametrize("key", SETTINGS)
def test_the_verbs_of_a_setting_are_those_that_have_the_option(key: str) -> None:
    built_in, verbs = SETTINGS[key]
    others = {"graph", "export"} if key == "format" else set()  # theirs is what they make, not how they show it
    having = {
        words[0]: option
        for words, command in commands().items()
        for option in command.params
        if f"--{key}" in option.opts and words[0] not in others
    }
    assert sorted(having) == sorted(verbs or {words[0] for words in commands()})
    if key in {"threshold", "within"}:
        assert {option.default for option in having.values()} == {built_in}


def defaults(keymint, cwd: Path, *options: str, env: Mapping[str, str] | None = None) -> dict[str, tuple]:
    """Return each default with its source and place, as ``status -v`` says."""
    outcome = keymint("status", "-v", "--json", *options, cwd=cwd, env=env)
    assert outcome.code == 0, outcome.out + outcome.err
    rows = outcome.document["result"]["defaults"]
    return {f"{row['verb'] or ''} {row['option']}".strip(): (row["value"], row["source"], row["place"]) for row in rows}


@pytest.fixture
def user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's own file of defaults."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "config/keymint").mkdir(parents=True)
    return tmp_path / "config/keymint/keymint.toml"


def test_the_stronger_one_is_shown_with_its_place(keymint, provisioned: Path, user: Path) -> None:
    assert defaults(keymint, provisioned)["--jobs"] == ("all cores", "built-in", None)
    user.write_text("jobs = 2\nquiet = false\nwithin = '10d'\n")
    assert defaults(keymint, provisioned)["--jobs"] == ("2", "user", "../config/keymint/keymint.toml:1")
    (provisioned / "keymint.toml").write_text("\n\njobs = 3 # three\n\n\n'within' = \"20d\"\n")
    found = defaults(keymint, provisioned, env={"KEYMINT_RENEW_THRESHOLD": "50%"})
    assert found["--jobs"] == ("3", "workspace", "keymint.toml:3")
    assert found["--within"] == ("20d", "workspace", "keymint.toml:6")
    assert found["renew --threshold"] == ("50%", "environment", "$KEYMINT_RENEW_THRESHOLD")
    assert defaults(keymint, provisioned, env={"KEYMINT_JOBS": "4"})["--jobs"][:2] == ("4", "environment")
    shown = keymint("status", "-v", cwd=provisioned).out
    assert ["--jobs", "-", "3", "workspace", "keymint.toml:3"] in [line.split() for line in shown.splitlines()]


def test_precedence_by_its_effect(keymint, provisioned: Path, user: Path) -> None:
    def findings(*options: str, **env: str) -> int:
        return keymint("check", *options, cwd=provisioned, env=env).code

    assert findings() == 0
    user.write_text("within = '2y'\n")
    assert findings() == 3
    (provisioned / "keymint.toml").write_text("within = '0d'\n")
    assert findings() == 0
    assert findings(KEYMINT_WITHIN="2y") == 3
    assert findings(KEYMINT_WITHIN="2y", KEYMINT_CHECK_WITHIN="0d") == 0
    assert findings("--within", "2y", KEYMINT_WITHIN="0d") == 3
    assert findings("--within", "0d", KEYMINT_WITHIN="2y") == 0


def test_what_is_said_for_a_verb_is_for_it_only(keymint, provisioned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (provisioned / "keymint.toml").write_text("format = 'openmetrics'\n")
    monkeypatch.setenv("KEYMINT_CHECK_QUIET", "1")
    assert keymint("status", cwd=provisioned).out.startswith("# ")
    assert keymint("status", "--format", "table", cwd=provisioned).out.startswith("PACKAGE")
    assert keymint("check", cwd=provisioned).out == ""
    assert keymint("check", "-v", cwd=provisioned).out != ""


def test_of_quiet_and_verbose_the_stronger_one_counts(keymint, provisioned: Path, user: Path) -> None:
    user.write_text("quiet = true\n")
    assert keymint("status", cwd=provisioned).out == ""
    assert keymint("status", cwd=provisioned, env={"KEYMINT_VERBOSE": "1"}).out != ""
    (provisioned / "keymint.toml").write_text("verbose = true\n")
    assert "--jobs" in keymint("status", cwd=provisioned).out
    assert keymint("status", "-q", cwd=provisioned).out == ""


def test_a_change_is_seen_although_the_answer_is_on_record(keymint, just_provisioned: Path, policy: Path) -> None:
    for _ in range(2):
        assert "nothing to do" in keymint("provision", policy, "-w", "ws").out
    (just_provisioned / "keymint.toml").write_text("quiet = true\n")
    assert keymint("provision", policy, "-w", "ws").out == ""
    (just_provisioned / "keymint.toml").unlink()
    assert "nothing to do" in keymint("provision", policy, "-w", "ws").out
    assert keymint("provision", policy, "-w", "ws", env={"KEYMINT_QUIET": "yes"}).out == ""


@pytest.mark.parametrize(
    ("text", "code", "line", "said"),
    [
        ("prove = false\n", "default-unknown", 1, "command line"),
        ("# c\n\nforce = true\n", "default-unknown", 3, "command line"),
        ("colour = 'never'\n", "default-unknown", 1, "'color'"),
        ("job = 3\n", "default-unknown", 1, "'jobs'"),
        ("verbosity = 1\n", "default-unknown", 1, "'verbose'"),
        ("# c\nwithn = '3d'\n", "default-unknown", 2, "'within'"),
        ("[install]\nprove = false\n", "default-unknown", 1, "command line"),
        ("\n[check]\nwithin = '3d'\n", "default-unknown", 2, "command line"),
        ("install.prove = false\n", "default-unknown", 1, "command line"),
        ("jobs = 0\n", "default-invalid", 1, "1<=x<=256"),
        ("jobs = 1.5\n", "default-invalid", 1, "jobs: '1.5' is not"),
        ("jobs = true\n", "default-invalid", 1, "jobs: 'True' is not"),
        ("jobs = [1]\n", "default-invalid", 1, "jobs"),
        ("quiet = 'true'\n", "default-invalid", 1, "write it without quotes, e.g. quiet = true"),
        ("jobs = 'four'\n", "default-invalid", 1, "write it without quotes, e.g. jobs = 4"),
        ("jobs = '4'\n", "default-invalid", 1, "write it without quotes, e.g. jobs = 4"),
        ("color = 'blue'\n", "default-invalid", 1, "'always'"),
        ("within = 3\n", "default-invalid", 1, "not a length of time"),
        ("within = 'soon'\n", "default-invalid", 1, "30d"),
        ("threshold = '120%'\n", "default-invalid", 1, "threshold"),
        ("format = 'yaml'\n", "default-invalid", 1, "openmetrics"),
        ("jobs = 1\njobs = 2\n", "default-invalid", 2, "not TOML"),
        ("jobs = \n", "default-invalid", 1, "not TOML"),
        ("a = " + "[" * 5000, "default-invalid", 1, "not TOML"),
        ("x = 1" + "0" * 5000, "default-invalid", 1, "not TOML"),
        ("# é".encode("latin-1"), "default-invalid", 1, "UTF-8"),
        ("\0", "default-invalid", 1, "not TOML"),
        (b"\xff\xfej\0", "default-invalid", 1, "UTF-8"),
        ("#" * (MAX_BYTES + 1), "file-size", None, ""),
    ],
    ids=lambda value: repr(value)[:40],
)
def test_what_is_refused(keymint, provisioned: Path, text: str | bytes, code: str, line: int | None, said: str) -> None:
    (provisioned / "keymint.toml").write_bytes(text.encode() if isinstance(text, str) else text)
    outcome = keymint("check", "--json", cwd=provisioned)
    (found, *_) = outcome.document["diagnostics"]
    assert (found["code"], found["file"], found["line"]) == (code, "keymint.toml", line)
    assert said in f"{found['message']} {found['help']}"
    assert outcome.code in {1, 2}


def test_all_mistakes_are_told_at_once(keymint, provisioned: Path) -> None:
    (provisioned / "keymint.toml").write_text("prove = false\njobs = 0\n[chekc]\n")
    outcome = keymint("status", cwd=provisioned, env={"KEYMINT_WITHIN": "soon"})
    assert outcome.code == 2
    assert len(outcome.err.splitlines()) == 4
    assert "$KEYMINT_WITHIN: 'soon' is not a length of time" in outcome.err


@pytest.mark.parametrize("kind", ["folder", "link", "fifo"])
def test_what_is_no_file(keymint, provisioned: Path, tmp_path: Path, kind: str) -> None:
    path = provisioned / "keymint.toml"
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    else:
        (tmp_path / "other.toml").write_text("jobs = 1\n")
        path.symlink_to(tmp_path / "other.toml")
    outcome = keymint("status", "--json", cwd=provisioned)
    assert outcome.codes() == ["symlink-refused" if kind == "link" else "file-kind"]


def test_the_users_own_file_may_be_a_link(keymint, provisioned: Path, tmp_path: Path, user: Path) -> None:
    (tmp_path / "dotfiles.toml").write_text("jobs = 2\n")
    user.symlink_to(tmp_path / "dotfiles.toml")
    assert defaults(keymint, provisioned)["--jobs"][0] == "2"


def test_no_variable_switches_anything_else(keymint, policy: Path, tmp_path: Path) -> None:
    every = {
        f"KEYMINT_{prefix}{option.opts[-1].lstrip('-').replace('-', '_').upper()}": "1"
        for words, command in commands().items()
        for option in command.params
        for prefix in ("", f"{'_'.join(words).upper()}_")
        if isinstance(option, click.Option) and option.opts[-1][2:] not in SETTINGS
    }
    plain = keymint("provision", policy, "-w", "ws", "--dry-run")
    assert keymint("provision", policy, "-w", "ws", "--dry-run", env=every) == plain
    assert plain.code == 0
    assert not (tmp_path / "ws").exists()


def test_help_needs_no_defaults(keymint, provisioned: Path) -> None:
    (provisioned / "keymint.toml").write_text("= nonsense")
    assert keymint("--help", cwd=provisioned).code == 0
    assert keymint("check", "--help", cwd=provisioned).code == 0


@pytest.mark.parametrize(
    ("options", "env", "coloured"),
    [
        ((), {}, False),
        (("--color", "always"), {}, True),
        (("--color", "always"), {"NO_COLOR": "1"}, True),
        ((), {"FORCE_COLOR": "1"}, True),
        ((), {"FORCE_COLOR": "0"}, False),
        ((), {"FORCE_COLOR": "1", "NO_COLOR": "1"}, False),
        (("--color", "never"), {"FORCE_COLOR": "1"}, False),
        (("--color", "auto"), {"FORCE_COLOR": "1"}, True),
        ((), {"KEYMINT_COLOR": "always"}, True),
        ((), {"KEYMINT_COLOR": "always", "NO_COLOR": "1"}, True),
        (("--color", "never"), {"KEYMINT_COLOR": "always"}, False),
    ],
    ids=str,
)
def test_colours(keymint, provisioned: Path, options: tuple[str, ...], env: Mapping[str, str], coloured: bool) -> None:
    for _ in range(2):  # the second time it may be told from the record
        assert ("\033[" in keymint("status", *options, cwd=provisioned, env=env).out) == coloured
    assert ("\033[" in keymint("status", "no", *options, cwd=provisioned, env=env).err) == coloured
    assert ("\033[" in keymint(*options, "status", cwd=provisioned, env=env).out) == coloured
