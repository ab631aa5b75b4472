# SPDX-License-Identifier: Apache-2.0
"""``ros2 keymint``, by the entry point of the installed distribution and by the shim.

No ROS is here. ``STAND_IN`` does what ros2cli does: it finds commands by entry points, makes a parser for each, parses
the arguments once with help switched off to see which command is meant, creates that command alone, lets it add
arguments, parses again, and returns what ``main`` returns.
"""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from keymint.ros2_command import KeymintCommand
from tests.conftest import CHECKOUT, NOW

SHIM = CHECKOUT / "examples/ros2_shim"
GROUP = "ros2cli.command"
STAND_IN = """
import argparse, contextlib, importlib.metadata, sys

FOUND = {each.name: each for each in importlib.metadata.entry_points(group="ros2cli.command")}

def created(name):
    command = FOUND[name].load()()
    command.NAME = name
    return command

@contextlib.contextmanager
def without_help(parsers):
    before = [(each, each.print_help, each.exit) for each in parsers]
    for each, _, leave in before:
        each.print_help = lambda: None
        each.exit = lambda status=0, message=None, leave=leave: leave(status, message) if status else None
    yield
    for each, show, leave in before:
        each.print_help, each.exit = show, leave

def main():
    parser = argparse.ArgumentParser(prog="ros2")
    parser.add_argument("--use-python-default-buffering", action="store_true")
    commands = parser.add_subparsers(title="Commands")
    commands.dest, commands.required = " command", False
    parsers = {name: commands.add_parser(name) for name in sorted(FOUND)}
    with without_help([parser, *parsers.values()]):
        known, _ = parser.parse_known_args()
    name = getattr(known, " command")
    if name is None:
        lines = (f"  {each}  {created(each).__doc__.splitlines()[0].strip().rstrip('.')}" for each in sorted(FOUND))
        parser.epilog = chr(10).join(lines)
    else:
        command = created(name)
        parsers[name].set_defaults(_command=command)
        command.add_arguments(parsers[name], f"ros2 {name}")
    args = parser.parse_args()
    sys.stdout.reconfigure(line_buffering=not args.use_python_default_buffering)
    command = getattr(args, "_command", None)
    if command is None:
        parser.print_help()
        return 0
    try:
        return command.main(parser=parser, args=args)
    except RuntimeError as error:
        return str(error)

sys.exit(main())
"""


@pytest.fixture(params=["entry point", "shim"])
def way(request: pytest.FixtureRequest, tmp_path: Path) -> dict[str, str]:
    """The environment of ``ros2`` for each way to install the command."""
    (tmp_path / "ros2").write_text(STAND_IN)
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "KEYMINT_TRACEBACK")}
    environment = {**kept, "SOURCE_DATE_EPOCH": str(NOW), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    if request.param == "entry point":
        return environment
    installed = tmp_path / "site"
    info = installed / "keymint_ros2cli-1.0.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: keymint_ros2cli\nVersion: 1.0.0\n")
    (info / "entry_points.txt").write_text(f"[{GROUP}]\nkeymint = keymint_ros2cli:KeymintCommand\n")
    (installed / "keymint_ros2cli").symlink_to(SHIM / "keymint_ros2cli")
    return {**environment, "PYTHONPATH": str(installed)}


def ros2(way: dict[str, str], cwd: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, cwd / "ros2", *arguments], cwd=cwd, env=way, capture_output=True, text=True, check=False
    )


def test_ros2_lists_it(way: dict[str, str], tmp_path: Path) -> None:
    done = ros2(way, tmp_path, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert "keymint Mint keys and notarize access control for robots" in done.stdout


def test_all_arguments_and_exit_codes_pass(way: dict[str, str], keymint, policy: Path, tmp_path: Path) -> None:
    calls = (
        ["--help"],
        ["provision", "-h"],
        ["--unknown", "lint"],
        ["lint", "--json", "--", "missing.xml"],
        ["query", policy.name, "isolated", "/talker", "/robot1/listener"],
    )
    codes = set()
    for arguments in calls:
        done, expected = ros2(way, tmp_path, "keymint", *arguments), keymint(*arguments)
        assert (done.returncode, done.stdout, done.stderr) == (expected.code, expected.out, expected.err)
        codes.add(done.returncode)
    assert codes == {0, 1, 2, 3}
    option_first = ros2(way, tmp_path, "--use-python-default-buffering", "keymint", "--version")
    assert (option_first.returncode, option_first.stdout) == (0, keymint("--version").out)


def test_it_provisions(way: dict[str, str], keymint, policy: Path, tmp_path: Path) -> None:
    done = ros2(way, tmp_path, "keymint", "provision", policy.name, "-w", "ws", "-q")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert keymint("check", "-w", "ws").code == 0


def test_a_signal_ends_it(way: dict[str, str], ws: Path, tmp_path: Path) -> None:
    command = [sys.executable, tmp_path / "ros2", "keymint", "install", "-w", ws]
    with (ws / ".keymint/lock").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with subprocess.Popen(command, cwd=tmp_path, env=way, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr
            assert process.stderr.readline().startswith("Waiting for the workspace lock")
            process.send_signal(signal.SIGINT)
            assert "interrupted" in process.communicate()[1]
    assert process.returncode == 130


def test_loading_it_imports_nothing_heavy() -> None:
    code = (
        "import sys; from importlib.metadata import entry_points\n"
        f"before = set(sys.modules); (found,) = entry_points(group='{GROUP}', name='keymint')\n"
        "command = found.load()()\n"
        "assert command.__doc__; print(*sorted({name.partition('.')[0] for name in set(sys.modules) - before}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "keymint" in loaded
    assert not loaded & {"click", "lxml", "cryptography", "argparse", "rclpy", "ros2cli"}


def test_the_distribution_registers_it() -> None:
    (found,) = entry_points(group=GROUP, name="keymint")
    assert found.load() is KeymintCommand


def test_the_shim_says_that_keymint_is_missing(tmp_path: Path) -> None:
    code = (
        "import types; from keymint_ros2cli import KeymintCommand\n"
        "KeymintCommand().main(parser=None, args=types.SimpleNamespace(keymint_arguments=[]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=SHIM, env={"PATH": str(tmp_path)}, capture_output=True, text=True, check=False
    )
    said = done.stderr.splitlines()[-1]
    assert said.startswith("RuntimeError: cannot run keymint: No such file or directory; install it, e.g. by 'pipx")


def test_the_shim_registers_the_same_name() -> None:
    assert '{"ros2cli.command": [f"keymint = {NAME}:KeymintCommand"]}' in (SHIM / "setup.py").read_text()
