# SPDX-License-Identifier: Apache-2.0
"""The shell offers a value for every option and argument that has a closed set of values, or takes names that exist."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.shell_completion import BashComplete

from keymint import cli
from keymint.output.console import Streams

FREE = {
    # numbers, lengths of time, texts and digests
    *("--authority-fingerprint", "--budget", "--domain", "--fingerprint", "--jobs", "--limit", "--min-coverage"),
    *("--partition", "--pin-env", "--pkcs11", "--scale", "--seconds", "--states", "--threshold", "--title"),
    *("--valid-for", "--within", "--soon", "--since"),
    # identifiers in a capture that is read later
    "discover --subject",
    # policies: a file, a folder, or REVISION:PATH
    *("diff old", "diff new"),
}
"""Options and arguments whose values nobody can list. Whoever adds one that is not here gives it a completion."""
TYPED = {
    "why permission": ("/talker",),
    "why object_name": ("/talker", "publish"),
    "authority import certificate": ("identity_ca",),
    "set value": ("distro",),
}
"""What is typed before an argument that is not the first one."""
EXPECTED = {
    "set setting": "domain",
    "set value": "jazzy",
    "why subject": "/talker",
    "why permission": "ros_publish",
    "why object_name": "/chatter",
    "query words": "who",
    "create given": "robot1/listener",
    "revoke given": "talker",
    "env enclave": "talker",
    "request name": "/talker",
    "provision --distro": "jazzy",
    "init --transport": "dds",
    "init --layout": "sros2",
    "init --subject-format": "unique",
    "export --format": "sros2",
    "lint --build-type": "keymint_ros2_dds",
    "verify --implementation": "omg",
    "graph --subject": "/talker",
    "graph --format": "svg",
    "status --format": "openmetrics",
    "check --vendors": "fastdds=",
    "authority renew name": "identity_ca",
    "install --new-authority": "permissions_ca",
    "status --color": "always",
    "harden step": "names",
    "explain codes": "default-unknown",
    "renew --state": "due",
    "authority show names": "identity_ca",
    "prove --distro": "humble",
}
"""A value for some of them."""


def parameters(group: click.Group, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], click.Parameter]]:
    """Yield the options and arguments that take a value, each with the words of its verb."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from parameters(command, (*path, name))
        elif command is not None:
            for each in command.params:
                is_flag = isinstance(each, click.Option) and (each.is_flag or each.count)
                if not is_flag and not isinstance(each.type, click.Path):
                    yield (*path, name), each


ALL = {
    f"{' '.join(words)} {each.opts[-1] if each.opts else each.name}": (words, each)
    for words, each in parameters(cli.cli)
}
CLOSED = [
    name
    for name in ALL
    if name not in FREE and name.rpartition(" ")[2] not in FREE and "former" not in str(ALL[name][1].name)
]


def offered(folder: Path, arguments: list[str], incomplete: str = "") -> list[str]:
    """Return what is offered in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        streams = Streams(sys.stdout, sys.stderr)
        extra = {"obj": lambda: cli.setting(cli.call_of(()), streams)}
        shell = BashComplete(cli.cli, extra, "keymint", "_KEYMINT_COMPLETE")
        return [each.value for each in shell.get_completions(arguments, incomplete)]
    finally:
        os.chdir(before)


@pytest.fixture(scope="module")
def workspace(made: Path) -> Path:
    """A workspace that nobody changes."""
    return made / "ws"


@pytest.mark.parametrize("name", CLOSED)
def test_every_closed_set_is_offered(workspace: Path, name: str) -> None:
    if name.endswith(("--trust-package", "--accept-package")):
        pytest.skip("ROS packages: below")
    words, parameter = ALL[name]
    typed = [*words, *TYPED.get(name, ())]
    if isinstance(parameter, click.Option):
        typed.append(parameter.opts[-1])
    found = offered(workspace, typed)
    assert found, name
    assert found == list(dict.fromkeys(found))
    assert EXPECTED.get(name, found[0]) in found
    assert not any(any(ord(char) < 32 for char in each) for each in found)
    begin = EXPECTED.get(name, found[0])[:3]
    assert offered(workspace, typed, begin) == [each for each in found if each.startswith(begin)]
    assert offered(workspace, typed, "\0nothing") == []


def test_the_tables_name_what_is_there() -> None:
    known = {*ALL, *(name.rpartition(" ")[2] for name in ALL)}
    assert {*FREE, *EXPECTED} - known == set()


@pytest.mark.parametrize(
    ("words", "following"),
    [
        ((), ("who", "what", "can", "flows", "isolated")),
        (("who",), ("can",)),
        (("who", "can"), ("ros_publish",)),
        (("who", "can", "publish"), ("/chatter",)),
        (("what", "can"), ("/talker", "/robot1/listener")),
        (("what", "can", "/talker"), ("do",)),
        (("can", "/talker"), ("ever", "ros_publish")),
        (("can", "/talker", "ever"), ("ros_publish",)),
        (("can", "/talker", "ever", "publish"), ("/chatter",)),
        (("flows", "/talker"), ("/robot1/listener",)),
        (("profile/comarmor.d", "who"), ("can",)),
    ],
    ids=str,
)
def test_the_words_of_a_query(workspace: Path, words: tuple[str, ...], following: tuple[str, ...]) -> None:
    found = offered(workspace, ["query", *words])
    assert {*following} <= {*found}
    assert ("can" in found) == ("can" in following)


def test_the_policy_that_was_typed_counts(policy: Path, tmp_path: Path) -> None:
    assert "/talker" in offered(tmp_path, ["query", str(policy), "what", "can"])


def test_without_a_workspace_nothing_is_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "p.xml").write_text("no policy")
    for words in (
        ["why"],
        ["check"],
        ["authority", "renew"],
        ["why", "/a", "publish"],
        ["query", "p.xml", "what", "can"],
    ):
        assert offered(tmp_path, words) == []
    assert capfd.readouterr() == ("", "")


def test_a_workspace_that_is_named_counts(workspace: Path, tmp_path: Path) -> None:
    assert "talker" in offered(tmp_path, ["revoke", "-w", str(workspace)])
    assert "/chatter" in offered(tmp_path, ["why", "-w", str(workspace), "/talker", "publish"])


def test_ros_packages_that_ship_profiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "share/nav/keymint/comarmor.d"
    folder.mkdir(parents=True)
    (folder / "nav.xml").write_text("<profiles/>")
    index = tmp_path / "share/ament_index/resource_index"
    for kind in ("packages", "keymint"):
        (index / kind).mkdir(parents=True)
        (index / kind / "nav").write_text("")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert offered(tmp_path, ["provision", "--trust-package"]) == ["nav"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_gets_them(workspace: Path, shell: str) -> None:
    environment = {
        **os.environ,
        "_KEYMINT_COMPLETE": f"{shell}_complete",
        "COMP_WORDS": "keymint why /ta",
        "COMP_CWORD": "2",
    }
    if shell == "fish":
        environment["COMP_CWORD"] = "/ta"
    done = subprocess.run(
        [sys.executable, "-m", "keymint"], cwd=workspace, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert "/talker" in done.stdout.replace(",", "\n").split("\n")
