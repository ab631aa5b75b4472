# SPDX-License-Identifier: Apache-2.0
"""Discover a running system, learn its policy, and run the system secured by it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from keymint_ros2_dds.discovery import graph_source
from keymint_ros2_dds.vendors.participants import DeniedError, System, free_ports

from .provisioning import enclave

pytestmark = pytest.mark.cyclonedds

NODE_SERVICES = (
    "describe_parameters",
    "get_parameters",
    "get_parameter_types",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
DOMAIN = 0
Edges = list[tuple[str, str, list[str]]]


class Unsecured:
    """Participants without security that see each other and the observer, on loopback and separate ports."""

    def __init__(self, stack: ExitStack, first_port: int) -> None:
        self._stack = stack
        self.configuration = configuration(first_port)
        self._environment = {**os.environ, "CYCLONEDDS_URI": self.configuration}
        self._environment.pop("SOURCE_DATE_EPOCH", None)
        searched = os.pathsep.join(str(Path(entry).resolve()) for entry in sys.path if entry)
        self._environment["PYTHONPATH"] = searched

    def begin(self, *, name: str = "", user_data: str = "", edges: Edges) -> subprocess.Popen[str]:
        """Start a participant, and wait until it is running."""
        command = [sys.executable, str(Path(__file__).with_name("unsecured.py")), str(DOMAIN)]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=self._environment
        )
        self._stack.callback(end, process)
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps({"name": name, "user_data": user_data, "edges": edges}) + "\n")
        process.stdin.flush()
        assert process.stdout.readline() == "READY\n"
        return process

    def discovering(self, output: Path, *arguments: str, seconds: float = 2.0) -> subprocess.Popen[str]:
        """Start ``keymint discover``."""
        command = [sys.executable, "-m", "keymint", "discover", "--domain", str(DOMAIN), "--seconds", str(seconds)]
        process = subprocess.Popen(
            [*command, "-o", str(output), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self._environment,
        )
        self._stack.callback(end, process)
        return process

    def discover(self, output: Path, *arguments: str, seconds: float = 2.0) -> dict[str, list[dict[str, object]]]:
        """Run ``keymint discover``; return the graph."""
        return graph(self.discovering(output, *arguments, seconds=seconds), output)


def graph(process: subprocess.Popen[str], output: Path) -> dict[str, list[dict[str, object]]]:
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, out + err
    document: dict[str, list[dict[str, object]]] = json.loads(output.read_text())
    return document


def end(process: subprocess.Popen[str]) -> None:
    """Terminate a process, or kill it."""
    try:
        process.communicate(timeout=10)
    except (subprocess.TimeoutExpired, ValueError):
        process.kill()
        process.wait()
    for stream in (process.stdin, process.stdout, process.stderr):
        if stream is not None:
            stream.close()


def configuration(first_port: int) -> str:
    """Return the configuration that limits Cyclone DDS to loopback and the ports of this test."""
    return (
        "<CycloneDDS><Domain Id='any'><General><Interfaces>"
        "<NetworkInterface address='127.0.0.1' multicast='false'/></Interfaces>"
        "<AllowMulticast>false</AllowMulticast></General><Discovery><Peers><Peer Address='127.0.0.1'/></Peers>"
        "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>9</MaxAutoParticipantIndex>"
        f"<Ports><Base>{first_port}</Base><DomainGain>0</DomainGain></Ports></Discovery></Domain></CycloneDDS>"
    )


@pytest.fixture
def running() -> Iterator[Unsecured]:
    usable = graph_source.usable()
    if not usable.usable:
        message = f"{usable.reason}; {usable.help}"
        if os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
            pytest.fail(message, pytrace=False)
        pytest.skip(message)
    with free_ports() as first_port, ExitStack() as stack:
        yield Unsecured(stack, first_port)


def node(name: str, edges: Edges) -> Edges:
    """Return the edges of a node, including those that every ROS 2 node has."""
    served = [
        edge
        for service in NODE_SERVICES
        for edge in (
            ("subscribe", f"rq{name}/{service}Request", []),
            ("publish", f"rr{name}/{service}Reply", []),
        )
    ]
    return [*edges, *served, ("publish", "rt/rosout", []), ("publish", "ros_discovery_info", [])]


TALKER = node("/talker", [("publish", "rt/chatter", [])])
LISTENER = node("/listener", [("subscribe", "rt/chatter", [])])


def short(document: dict[str, list[dict[str, object]]]) -> set[tuple[object, ...]]:
    return {(edge["subject"], edge["permission"], edge["object"]) for edge in document["edges"]}


def test_names_partitions_and_types_are_recorded_and_the_user_can_override_names(
    running: Unsecured, tmp_path: Path
) -> None:
    running.begin(name="talker", edges=[("publish", "chatter", ["rt/robot1"])])
    running.begin(user_data="enclave=/robot1/arm;", edges=[("subscribe", "rt/joints", [])])
    running.begin(user_data="enclave=/;", edges=node("/robot2/leg", [("publish", "odd", ["b", "a"])]))
    found = running.discover(tmp_path / "g.json", "-v")
    assert found["subjects"] == ["/robot1/arm", "/robot2/leg", "/talker"]
    assert {
        ("/talker", "ros_publish", "/robot1/chatter"),
        ("/robot1/arm", "ros_subscribe", "/joints"),
        ("/robot2/leg", "publish", "odd"),
        ("/robot2/leg", "publish", "ros_discovery_info"),
        ("/robot2/leg", "ros_execute", "/robot2/leg/get_parameters"),
    } <= short(found)
    (odd,) = [edge for edge in found["edges"] if edge["object"] == "odd"]
    assert (odd["partitions"], odd["domain"]) == (["a", "b"], DOMAIN)
    assert {"kind": "ros_topic", "object": "/joints", "type": "std_msgs/msg/String"} in found["types"]


def test_participants_that_come_late_or_leave_early_are_recorded(
    running: Unsecured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The observer runs in this process, so that it surely listens when others come and go."""
    monkeypatch.setenv("CYCLONEDDS_URI", running.configuration)
    early = running.begin(name="early", edges=[("publish", "rt/early", [])])

    def happenings() -> Iterator[None]:
        started = time.monotonic()
        while time.monotonic() < started + 1:
            yield
        end(early)
        brief = running.begin(name="brief", edges=[("subscribe", "rt/brief", [])])
        time.sleep(0.4)  # time for the announcement, while the observer is not polled
        end(brief)
        running.begin(name="late", edges=[("publish", "rt/late", [])])
        started = time.monotonic()
        while time.monotonic() < started + 1:
            yield

    happening = happenings()
    found = graph_source.observe(DOMAIN, lambda: next(happening, False) is None, {})
    seen = {(edge.subject, edge.permission, edge.object.name) for edge in found.graph.edges}
    assert seen == {
        ("/early", "publish", "rt/early"),
        ("/brief", "subscribe", "rt/brief"),
        ("/late", "publish", "rt/late"),
    }


def test_a_system_without_participants(running: Unsecured, tmp_path: Path) -> None:
    process = running.discovering(tmp_path / "g.json", seconds=0.2)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "no participant seen in domain 0" in err


def test_from_a_running_system_to_the_same_one_secured(
    running: Unsecured, cyclonedds, provisioned: Callable[[Path], Path], tmp_path: Path, keymint
) -> None:
    talker = running.begin(name="talker", edges=TALKER)
    listener = running.begin(name="listener", edges=LISTENER)
    found = running.discover(tmp_path / "graph.json")
    for process in (talker, listener):
        end(process)
    assert found["subjects"] == ["/listener", "/talker"]
    assert len(found["edges"]) == 2 * (1 + len(NODE_SERVICES) + 1 + 1)
    policy = tmp_path / "policy.xml"
    assert keymint("learn", tmp_path / "graph.json", "-o", policy).code == 0
    install = provisioned(policy)

    with System(cyclonedds) as system:
        first = system.open(enclave(install, "/talker"))
        second = system.open(enclave(install, "/listener"))
        for participant, edges in ((first, TALKER), (second, LISTENER)):
            for permission, topic, partitions in edges:
                assert participant.allows(permission, topic, partitions), (permission, topic)
        writer, reader = first.edge("publish", "rt/chatter"), second.edge("subscribe", "rt/chatter")
        writer.write("hello")
        assert reader.read() == "hello"
        for participant, permission, topic in (
            (first, "subscribe", "rt/chatter"),
            (second, "publish", "rt/chatter"),
            (first, "publish", "rt/cmd_vel"),
            (second, "subscribe", "rq/talker/get_parametersRequest"),
        ):
            with pytest.raises(DeniedError):
                participant.edge(permission, topic)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_recorded_graph_is_written_when_a_signal_ends_the_recording(
    running: Unsecured, tmp_path: Path, number: signal.Signals, code: int
) -> None:
    running.begin(name="talker", edges=[("publish", "rt/chatter", [])])
    output = tmp_path / "g.json"
    process = running.discovering(output, seconds=600)
    time.sleep(4)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code, err
    assert "warning: interrupted after" in err
    assert json.loads(output.read_text())["subjects"] == ["/talker"]


def test_an_ignored_signal_stays_ignored(running: Unsecured, tmp_path: Path) -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited by the child, as from nohup
    try:
        process = running.discovering(tmp_path / "g.json", seconds=5)
    finally:
        signal.signal(signal.SIGINT, before)
    time.sleep(3)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "interrupted" not in err
