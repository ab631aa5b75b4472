# SPDX-License-Identifier: Apache-2.0
"""A value that is out of a known set is a usage error: exit code 2, in every verb, and nothing is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click
import pytest

from keymint.cli import VERBS, cli
from tests.conftest import snapshot

OPEN = {
    "install --new-authority",
    "provision --rekey",
    "query --partition",
    "why --partition",
    "graph --subject",
    "graph --namespace",
    "prove --distro",
    "verify --distro",
}
"""Options that take the name of something that only a workspace, a policy or a graph knows."""
ARGUMENTS = {
    "why": ("/talker", "ros_publish", "/chatter"),
    "diff": ("policy.xml", "policy.xml"),
    "query": ("policy.xml", "what", "can", "/talker", "do"),
    "provision": ("policy.xml",),
    "learn": ("graph.json",),
    "import": ("foreign.xml",),
    "export": ("policy.xml", "--format", "sros2"),
    "graph": ("policy.xml",),
    "lint": ("policy.xml",),
    "test": ("policy.xml",),
    "init": ("new_ws",),
}


def closed() -> list[tuple[str, str, str]]:
    """Return verb, option and a wrong value, of each option whose values are known."""
    found = []
    for verb in VERBS:
        command = cli.get_command(click.Context(cli), verb)
        assert command is not None
        for option in command.params:
            name = option.opts[-1]
            if not isinstance(option, click.Option) or option.is_flag or f"{verb} {name}" in OPEN:
                continue
            if str(option.name).startswith("former_"):  # it does the same, and tells its new name as well
                continue
            if isinstance(option.type, click.Choice) or option.metavar in {"NAME", "PERIOD", "ID=NAME"}:
                found.append((verb, name, "no-such-value"))
            elif isinstance(option.type, click.types._NumberRangeBase):
                found += [(verb, name, value) for value in ("-1", "1e300", "nan", "x", "", "\u0662\u200f")]
    return found


@pytest.fixture
def files(policy: Path) -> Path:
    (policy.parent / "graph.json").write_text('{"format": "keymint-graph", "version": 1}')
    return policy.parent


def test_the_list_of_options_is_found() -> None:
    found = {(verb, option) for verb, option, _ in closed()}
    assert {("init", "--distro"), ("init", "--layout"), ("verify", "--implementation"), ("check", "--within")} <= found
    assert {("diff", "--format"), ("lint", "--build-type"), ("discover", "--source"), ("why", "--domain")} <= found
    assert len(found) > 60


@pytest.mark.parametrize(("verb", "option", "value"), closed())
def test_a_value_out_of_a_known_set_is_wrong_usage(
    keymint: Callable, files: Path, verb: str, option: str, value: str
) -> None:
    if value == "1e300" and verb == "prove" and option == "--seconds":
        pytest.skip("a long time, but a time")
    before = snapshot(files)
    outcome = keymint(verb, *ARGUMENTS.get(verb, ()), f"{option}={value}", "--json")
    assert outcome.code == 2, outcome.out + outcome.err
    assert outcome.err == ""
    (said,) = outcome.document["diagnostics"]
    assert outcome.document["exit_code"] == 2
    assert said["severity"] == "error"
    assert "\n" not in said["message"] + said["help"]
    assert snapshot(files) == before


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("init", "x", "--distro", "jazy"), "did you mean 'jazzy'?"),
        (("provision", "policy.xml", "--distro", "Humble"), "did you mean 'humble'?"),
        (("verify", "-i", "cyclonedd"), "did you mean 'cyclonedds'?"),
        (
            ("provision", "policy.xml", "ws"),
            "expected: keymint provision [OPTIONS] POLICY (a workspace is named by -w: -w ws)",
        ),
        (("test", "policy.xml", "--min-coverage", "0.9"), "PERCENT goes to 100: --min-coverage 90"),
        (("lint", "policy.xml", "--policy-type", "keymint_ros_comarmor"), "did you mean 'keymint_ros2_comarmor'?"),
    ],
)
def test_what_is_near_is_offered(keymint: Callable, files: Path, arguments: tuple[str, ...], meant: str) -> None:
    outcome = keymint(*arguments)
    assert outcome.code == 2
    assert meant in outcome.err


def test_a_distribution_that_the_environment_names_is_wrong_usage(keymint: Callable, files: Path) -> None:
    assert keymint("init", "x", env={"ROS_DISTRO": "no-such"}).code == 2
    assert not (files / "x").exists()


def test_a_plugin_that_a_file_names_is_no_usage_error(keymint: Callable, provisioned: Path) -> None:
    profile = provisioned / "profile" / "keymint_profile.xml"
    text = profile.read_text()
    for wrong in (text.replace(">jazzy<", ">jazy<"), text.replace(">keymint_ros<", ">keymint_no<")):
        assert wrong != text
        profile.write_text(wrong)
        assert keymint("build", cwd=provisioned).code == 1
        profile.write_text(text)


@pytest.mark.parametrize("form", [("-w", "{}"), ("-w{}",), ("--workspace={}",), ("-qw", "{}")])
def test_an_option_takes_its_value_in_any_form(keymint: Callable, provisioned: Path, form: tuple[str, ...]) -> None:
    assert keymint("status", *(each.format(provisioned) for each in form)).code == 0
