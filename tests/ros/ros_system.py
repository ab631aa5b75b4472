# SPDX-License-Identifier: Apache-2.0
"""A network with nodes of the sourced ROS 2, and the commands of Keymint and ROS that tests run there."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from threading import Timer

from keymint_ros2_dds.vendors.participants import ProbeProcess, RefusedError
from keymint_ros2_dds.vendors.ros_network import RosNetwork

GRAPH = '<xi:include href="common/node/graph.xml" parse="xml"/>'
NODE = '<xi:include href="common/node.xml" parse="xml"/>'
SECONDS = 60.0
"""How long a message may take; machines are slow, and what is expected ends the wait."""
SILENCE = 3.0
"""How long nothing must arrive that the policy denies."""


def rule(kind: str, name: str, *permissions: str, qualifier: str = "ALLOW") -> str:
    """Return a rule."""
    allowed = "".join(f"<{each}/>" for each in permissions)
    attached = f"<attachment>{name}</attachment>"
    return f'<{kind} qualifier="{qualifier}">{attached}<permissions>{allowed}</permissions></{kind}>'


def policy(profiles: Mapping[str, str]) -> str:
    """Return a policy: the rules of each subject."""
    each = (
        f'<profile name="p{at}"><attachment>{subject}</attachment>{rules}</profile>'
        for at, (subject, rules) in enumerate(profiles.items())
    )
    return f'<profiles xmlns:xi="http://www.w3.org/2001/XInclude">{"".join(each)}</profiles>'


PAIR = policy(
    {
        "/talker": GRAPH + rule("ros_topic", "/chatter", "ros_publish"),
        "/listener": GRAPH + rule("ros_topic", "/chatter", "ros_subscribe"),
    }
)


class RosSystem:
    """A network of one test, and a folder for its files."""

    def __init__(self, network: RosNetwork, folder: Path) -> None:
        self.network = network
        self.folder = folder
        self._programs = 0

    # -- Keymint --------------------------------------------------------------------------------------------------

    def keymint(self, *arguments: object, code: int = 0, inside: bool = False) -> str:
        """Run the command, in the network if ``inside``; return what it prints."""
        searched = os.pathsep.join(str(Path(entry).resolve()) for entry in sys.path if entry)
        variables = {**self.network.variables(None), "PYTHONPATH": searched}
        ros = self.network.variables(None).get("PYTHONPATH", "")
        if "--ros" in arguments:  # in the user's shell both are on this path
            variables["PYTHONPATH"] = os.pathsep.join((ros, searched))
        variables.pop("SOURCE_DATE_EPOCH", None)
        prefix = self.network.inside if inside else ()
        return run([*prefix, sys.executable, "-m", "keymint", *map(str, arguments)], variables, self.folder, code)

    def provision(self, text: str, name: str = "ws", *arguments: object) -> Path:
        """Provision a policy in a workspace of this name; return its install space."""
        file = self.folder / f"{name}.xml"
        file.write_text(text)
        self.keymint("provision", file, "-w", self.folder / name, *arguments)
        return self.folder / name / "install"

    # -- ROS ------------------------------------------------------------------------------------------------------

    def node(self, install: Path | None, enclave: str, domain: int = 0) -> ProbeProcess:
        """Start a stand-in node."""
        return self.network.node(install, enclave, domain)

    def refusal(self, install: Path | None, enclave: str, domain: int = 0) -> str:
        """Return why no stand-in node starts, or an empty text."""
        try:
            self.node(install, enclave, domain).reap()
        except RefusedError as error:
            return str(error)
        return ""

    def ros2(self, install: Path | None, *arguments: object, code: int = 0) -> str:
        """Run ``ros2``; return what it prints."""
        words = [*self.network.inside, "ros2", *map(str, arguments)]
        return run(words, self.network.variables(install), self.folder, code)

    def program(self, text: str, install: Path | None, *arguments: str) -> subprocess.Popen[str]:
        """Start a program of the user's in the Python of ROS; it ends with the test."""
        self._programs += 1
        file = self.folder / f"program{self._programs}.py"
        file.write_text(text)
        started = subprocess.Popen(
            [*self.network.inside, self.network.python, "-u", file, *arguments],
            env=dict(self.network.variables(install)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

        def end() -> None:
            started.kill()
            started.communicate()

        self.network.callback(end)
        return started


def run(words: Sequence[str], variables: Mapping[str, str], folder: Path, code: int) -> str:
    done = subprocess.run(words, env=dict(variables), cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == code, f"{words} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
    return done.stdout


# -- what nodes do --------------------------------------------------------------------------------------------------


def tried(node: ProbeProcess, permission: str, name: str) -> bool:
    """Tell whether a node may have this."""
    return node.ask("TRY", permission, name)[0] == "ALLOWED"


def kept(node: ProbeProcess, id_: str, permission: str, name: str) -> None:
    """Let a node create this; it stays."""
    assert node.ask("KEEP", id_, permission, name) == ("ALLOWED", "")


def delivered(sender: ProbeProcess, receiver: ProbeProcess, seconds: float, text: str = "hello") -> bool:
    """Tell whether what a node publishes by its ``out`` arrives at the ``in`` of another one in so many seconds."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        sender.ask("SEND", "out", text)
        answer, found = receiver.ask("READ", "in", "200", seconds=1)
        if answer == "SAMPLE" and found == text:
            return True
    return False


def answered(client: ProbeProcess, server: ProbeProcess, seconds: float, text: str = "7") -> bool:
    """Tell whether the ``in`` of one node answers the ``out`` of another one in so many seconds."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and client.ask("SEND", "out", text)[0] != "SENT":
        server.ask("READ", "in", "100", seconds=1)
    while time.monotonic() < deadline:
        server.ask("READ", "in", "200", seconds=1)
        if client.ask("READ", "out", "200", seconds=1) == ("SAMPLE", f"re: {text}"):
            return True
    return False


def first_line(process: subprocess.Popen[str], wanted: Callable[[str], bool]) -> str:
    """Return the first line of a program that is wanted; all that it prints in its time if there is none."""
    assert process.stdout is not None
    end = Timer(2 * SECONDS, process.kill)
    end.start()
    lines: list[str] = []
    for line in process.stdout:
        lines.append(line)
        if wanted(line):
            end.cancel()
            return line
    end.cancel()
    return "".join(lines)


def pair(ros: RosSystem, install: Path, other: Path | None = None) -> tuple[ProbeProcess, ProbeProcess]:
    """Start the talker and the listener of :data:`PAIR`, of one keystore or of two."""
    talker = ros.node(install, "/talker")
    listener = ros.node(other or install, "/listener")
    kept(talker, "out", "ros_publish", "/chatter")
    kept(listener, "in", "ros_subscribe", "/chatter")
    return talker, listener


def expectations(answers: Iterable[tuple[str, str, str, bool]]) -> str:
    """Return the unit test of a policy that says what nodes were allowed: subject, permission, name, answer."""
    lines = (
        f'<{"allow" if allowed else "deny"} subject="{subject}" permission="{permission}" object="{name}"/>'
        for subject, permission, name, allowed in answers
    )
    return f'<tests><test name="ROS">{"".join(lines)}</test></tests>'
