# SPDX-License-Identifier: Apache-2.0
"""The command line as a whole."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from keymint import SPACES
from keymint.cli import VERBS
from keymint.commands.life import authority


def run(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "keymint", *arguments],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_help_lists_every_verb(keymint) -> None:
    outcome = keymint("--help")
    assert outcome.code == 0
    assert all(verb in outcome.out for verb in VERBS)


WRITING = {f"authority {verb}" for verb in ("renew", "replace", "encrypt", "import")}
WRITING |= {"init", "create", "build", "install", "prove", "provision", "discover", "learn", "graph", "report"}
WRITING |= {
    "import",
    "fmt",
    "adopt",
    "harden",
    "export",
    "revoke",
    "remove",
    "set",
    "renew",
    "crl",
    "sign",
    "bundle",
    "accept",
    "issued",
}
"""Verbs that write files, so that they have ``--dry-run``."""
STAGES = {"init", "create", "build", "install", "provision", "prove", "verify", "check", "report"}
"""Verbs that divide packages among processes, so that they have ``--jobs``."""
ELSEWHERE = {
    "explain",
    "diff",
    "discover",
    "learn",
    "import",
    "plugins",
    "transports",
    "completion",
    "request",
    "accept",
}
"""Verbs that use no workspace, so that they have neither ``--workspace`` nor ``--src-space`` and the like."""


ALL = [*(verb for verb in VERBS if verb != "authority"), *(f"authority {verb}" for verb in authority.VERBS)]
"""All verbs; those of a group with its name."""


def test_help_of_a_group_lists_its_verbs(keymint) -> None:
    outcome = keymint("authority", "--help")
    assert outcome.code == 0
    assert all(verb in outcome.out for verb in authority.VERBS)


@pytest.mark.parametrize("verb", ALL)
def test_help_of_every_verb_teaches(keymint, verb: str) -> None:
    outcome = keymint(*verb.split(), "--help")
    assert outcome.code == 0
    for option in ("--json", "--verbose", "--quiet"):
        assert option in outcome.out
    assert ("--workspace" in outcome.out) == (verb not in ELSEWHERE)
    assert ("--dry-run" in outcome.out) == (verb in WRITING)
    assert ("--jobs" in outcome.out) == (verb in STAGES)
    assert not any(each in outcome.out for each in ("-space", "--profile-type", "--policy-type", "--source", "--hints"))
    assert "Show this message and exit" in outcome.out
    every = keymint(*verb.split(), "--help-all")
    assert every.code == 0
    for space in SPACES:
        assert (f"--{space}-space DIR" in every.out) == (verb not in ELSEWHERE)
    assert keymint(*verb.split(), "--help").out == outcome.out


@pytest.mark.parametrize(
    ("verb", "options"),
    [
        ("provision", {"--profile-type", "--subject-format", "--hints", "--no-optimise"}),
        ("lint", {"--profile-type", "--policy-type"}),
        ("graph", {"--source-type"}),
        ("discover", {"--source NAME"}),
        ("diff", {"--budget"}),
        ("prove", {"--states"}),
    ],
)
def test_options_that_few_users_need(keymint, verb: str, options: set[str]) -> None:
    usual, every = keymint(verb, "--help").out, keymint(verb, "--help-all").out
    assert {each for each in options if each in usual} == set()
    assert {each for each in options if each not in every} == set()
    assert "--help-all" in usual


@pytest.mark.parametrize(("verb", "former"), [("import", "--accept "), ("verify", "-t,"), ("build", "--renew")])
def test_former_names_of_options_are_never_listed(keymint, verb: str, former: str) -> None:
    assert former not in keymint(verb, "--help-all").out


def test_options_that_few_users_need_work(keymint, policy: Path) -> None:
    assert keymint("lint", policy, "--policy-type", "keymint_ros2_comarmor").code == 0


def test_all_help_of_a_group_is_its_help(keymint) -> None:
    for group in ((), ("authority",)):
        assert keymint(*group, "--help-all").out == keymint(*group, "--help").out


@pytest.mark.parametrize("verb", ["discover", "diff", "plugins"])
def test_a_verb_has_no_option_without_effect(keymint, verb: str) -> None:
    for option in ("--workspace", "--src-space"):
        outcome = keymint(verb, option, "ws")
        assert outcome.code == 2
        assert "No such option" in outcome.err


def test_an_unknown_verb(keymint) -> None:
    outcome = keymint("instal")
    assert outcome.code == 2
    assert "did you mean 'install'?" in outcome.err


def test_the_version(keymint) -> None:
    assert keymint("--version").out.startswith("keymint, version ")


@pytest.mark.parametrize("verb", ["create", "build", "install"])
def test_dry_run_writes_nothing(keymint, provisioned: Path, policy: Path, verb: str) -> None:
    from tests.conftest import snapshot

    policy.write_text(policy.read_text().replace("<permissions><ros_subscribe/>", "<permissions><ros_publish/>"))
    before = snapshot(provisioned)
    more = {"create": ["--all"], "install": ["--no-prove"]}.get(verb, [])
    outcome = keymint(verb, *more, "--dry-run", cwd=provisioned)
    assert outcome.code == 0
    assert snapshot(provisioned) == before


def test_quiet_says_nothing(keymint, policy: Path) -> None:
    outcome = keymint("provision", policy, "-w", "ws", "-q")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")


def test_no_colour_where_none_is_wanted(tmp_path: Path, policy: Path) -> None:
    command = [sys.executable, "-m", "keymint", "provision", str(policy), "-w", "ws"]
    script = f"import pty, sys; sys.exit(pty.spawn({command!r}))"
    for name, environment in (("plain", {"NO_COLOR": "1"}), ("coloured", {"NO_COLOR": ""})):
        (tmp_path / name).mkdir()
        done = subprocess.run(
            [sys.executable, "-c", script],
            cwd=tmp_path / name,
            env=os.environ | {"TERM": "xterm"} | environment,
            capture_output=True,
            check=True,
            stdin=subprocess.DEVNULL,
        )
        assert (b"\x1b[32m" in done.stdout) == (name == "coloured")


def test_python_dash_m(tmp_path: Path) -> None:
    assert run("--version", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize("more", ["", "-v", "--json"])
@pytest.mark.parametrize("stream", ["2>/dev/null", "2>&1 >/dev/null", "2>&1"])
def test_a_reader_that_stops_early_stops_nothing(policy: Path, stream: str, more: str) -> None:
    """The run does what was asked for, prints nothing, and has its own exit code, as a script reads it."""
    keymint = f"{sys.executable} -m keymint"
    script = (
        f"set -o pipefail; {keymint} provision {policy} -w ws {more} {stream} | true; echo $?; "
        f"{keymint} check -w ws --within 9y {more} {stream} | true; echo $?"
    )
    done = subprocess.run(["bash", "-c", script], cwd=policy.parent, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("0\n3\n", "")
    assert (policy.parent / "ws/install/enclaves/talker/permissions.p7s").is_file()


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts(keymint, shell: str) -> None:
    outcome = keymint("completion", shell)
    assert outcome.code == 0
    assert "_KEYMINT_COMPLETE" in outcome.out


def test_completion_knows_the_packages(provisioned: Path) -> None:
    done = run(cwd=provisioned, _KEYMINT_COMPLETE="bash_complete", COMP_WORDS="keymint build ro", COMP_CWORD="2")
    assert "robot1/listener" in done.stdout


def test_plugins_are_listed_with_where_they_come_from(keymint) -> None:
    outcome = keymint("plugins")
    assert outcome.code == 0
    for name in ("keymint_ros", "keymint_ros2_comarmor", "keymint_ros2_dds"):
        assert name in outcome.out
    assert "keymint-tools" in outcome.out


def test_an_error_of_our_own_is_one_line(tmp_path: Path) -> None:
    code = (
        "import keymint.run.run as c, sys; from keymint import cli\n"
        "def broken(*_): raise ZeroDivisionError('oops')\n"
        "c.Run.workspace = broken\nsys.exit(cli.main(['status']))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "internal error: ZeroDivisionError: oops" in done.stderr


@pytest.mark.parametrize(
    "arguments", [("init", "{}"), ("status", "-w", "{}"), ("provision", "{}"), ("init", "--policy", "{}")]
)
def test_a_name_that_is_too_long_is_one_clear_line(keymint, arguments: tuple[str, ...], tmp_path: Path) -> None:
    outcome = keymint(*(argument.format("a" * 300) for argument in arguments))
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.count("\n") == 1
    assert outcome.err.endswith("error: File name too long [system]\n")
    assert not any(tmp_path.iterdir())
