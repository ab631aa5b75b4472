# SPDX-License-Identifier: Apache-2.0
"""``keymint verify --ros``, with an imitation of rclpy; ``tests/ros`` has it on a real one."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from keymint_ros2_dds.transports import real_transports
from keymint_ros2_dds.vendors import ros_network
from keymint_ros2_dds.vendors.participants import RefusedError
from keymint_ros2_dds.vendors.ros_network import RosNetwork

from keymint.host.vendor_process import MissingVendorError, ProcessDiedError, ProcessFailedError
from tests.conftest import CHECKOUT, Outcome

POLICY = """<profiles><profile name="t"><attachment>/talker</attachment>
  <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
  <ros_service qualifier="ALLOW"><attachment>/reset</attachment><permissions><ros_call/></permissions></ros_service>
  <ros_action qualifier="ALLOW"><attachment>/go</attachment><permissions><ros_request/></permissions></ros_action>
  <topic qualifier="ALLOW"><attachment>raw</attachment><permissions><publish/></permissions></topic>
</profile></profiles>"""
GOAL = [f"client /go/_action/{each}" for each in ("send_goal", "cancel_goal", "get_result")]
PROGRESS = [f"subscription /go/_action/{each}" for each in ("feedback", "status")]
ALLOWED = ("publisher /chatter", "client /reset", *GOAL, *PROGRESS)


def environment(*allowed: str) -> dict[str, str]:
    """Return what a shell that has sourced the imitation adds."""
    return {
        "ROS_DISTRO": "jazzy",
        "PYTHONPATH": str(CHECKOUT / "tests/fake_ros"),
        "PATH": os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])),
        "FAKE_ALLOWED": ",".join(allowed),
        "TMPDIR": "/tmp",  # the network has another /dev/shm
    }


@pytest.fixture(scope="module", autouse=True)
def namespaces() -> None:
    """Require that this machine lets a user make namespaces."""
    done = subprocess.run([*ros_network.UNSHARE, "true"], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no namespace can be made here: {done.stderr.strip()}")


@pytest.fixture
def verified(keymint: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """Return a function that runs ``verify --ros`` with a ROS that allows something."""
    monkeypatch.setattr("tempfile.tempdir", "/tmp")
    assert keymint("provision", "policy.xml", "-w", "ws", "--distro", "jazzy").code == 0

    def run(*allowed: str, options: tuple[str, ...] = (), more: Mapping[str, str] | None = None) -> Outcome:
        return keymint("verify", "-w", "ws", "--ros", *options, env={**environment(*allowed), **(more or {})})

    return run


@pytest.fixture(autouse=True)
def policy(tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text(POLICY)


def test_what_ros_does_is_compared_with_the_policy(verified: Callable[..., Outcome]) -> None:
    outcome = verified(*ALLOWED, options=("--json",))
    assert outcome.code == 0, outcome.out
    result = outcome.document["result"]
    rows = {each["permission"]: each for each in result["operations"]}
    assert rows["ros_request"]["asked"] > 1
    assert sum(each["asked"] - each["denied"] for each in rows.values()) == 8  # the parts of the action are asked too
    assert sum(each["asked"] for each in rows.values()) == result["edges"]
    assert {each["text"] for each in result["denials"]} == {
        f"failed to create {kind} of …" for kind in ("publisher", "subscription", "client", "service")
    } | {
        f"failed to create {kind} of …/_action/{part}"
        for kind, part in (("client", "send_goal"), ("service", "send_goal"))
    }
    assert not any("raw" in str(each) for each in result["denials"]), "no node has raw topics"


@pytest.mark.parametrize(
    ("allowed", "error", "request_"),
    [
        ((*ALLOWED, "publisher /chatterx"), "false-positive", "/talker ros_publish /chatterx"),
        (ALLOWED[1:], "false-negative", "/talker ros_publish /chatter"),
    ],
)
def test_a_difference_is_reported(
    verified: Callable[..., Outcome], allowed: tuple[str, ...], error: str, request_: str
) -> None:
    report = verified(*allowed, options=("--json",))
    assert report.code == 3
    [finding] = report.document["result"]["transports"][0]["findings"]
    assert (finding["error"], finding["request"]) == (error, request_)
    outcome = verified(*allowed)
    assert outcome.code == 3
    assert request_ in outcome.out + outcome.err
    assert "ROS SAID" in outcome.out
    assert "1 mismatch" in outcome.out


def test_a_node_that_does_not_start_has_no_right(
    keymint: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", "/tmp")
    assert keymint("provision", "policy.xml", "-w", "ws", "--distro", "jazzy", "--layout", "flat").code == 0
    outcome = keymint("verify", "-w", "ws", "--ros", env=environment(*ALLOWED))
    assert outcome.code == 3
    assert "no node starts: SECURITY ERROR" in outcome.out


def test_without_ros_it_says_what_is_missing(verified: Callable[..., Outcome]) -> None:
    outcome = verified(more={"ROS_DISTRO": ""})
    assert outcome.code == 1
    assert "no ROS 2 is sourced" in outcome.err
    outcome = verified(more={"PYTHONPATH": "/nowhere"})
    assert outcome.code == 1
    assert "No module named 'rclpy'" in outcome.err
    outcome = verified(more={"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"})
    assert outcome.code == 1
    assert "not of DDS" in outcome.err
    assert verified(options=("--tier", "exchange")).code == 2


def test_files_that_nodes_would_not_see_are_an_error(
    verified: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(real_transports, "PRIVATE", Path("/tmp"))
    outcome = verified(*ALLOWED)
    assert outcome.code == 1
    assert "nodes see no file below /tmp (set TMPDIR)" in outcome.err


def test_where_no_network_can_be_made_nothing_is_started(
    verified: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_network, "UNSHARE", ("false",))
    outcome = verified(*ALLOWED)
    assert outcome.code == 1
    assert "network of its own" in outcome.err


def test_a_node_refuses_to_start_in_a_network_of_others() -> None:
    if len(socket.if_nameindex()) < 2:
        pytest.skip("this machine has nothing but loopback")
    program = Path(ros_network.__file__).with_name("ros_node.py")
    variables = {**os.environ, **environment()}
    for words in ((), ("network",)):
        done = subprocess.run(
            [sys.executable, program, *words], input="OPEN\t/a\n", env=variables, capture_output=True, text=True,
            check=True,
        )  # fmt: skip
        assert done.stdout.startswith("ERROR this network has")


def test_the_network_has_nothing_but_loopback_and_memory_of_its_own() -> None:
    with RosNetwork({**os.environ, **environment()}) as network:
        see = "import os, socket; print([n for _, n in socket.if_nameindex()], os.listdir('/dev/shm'))"
        done = subprocess.run([*network.inside, sys.executable, "-c", see], capture_output=True, text=True, check=True)
        connect = "import socket; socket.create_connection(('192.0.2.1', 9), 1)"
        away = subprocess.run([*network.inside, sys.executable, "-c", connect], capture_output=True, check=False)
    assert "lo" in done.stdout
    assert done.stdout.strip().endswith("[]")
    assert b"unreachable" in away.stderr


def test_the_commands_of_a_node(tmp_path: Path) -> None:
    allowed = (
        "publisher /a",
        "client /n/get_parameters",
        "service /x/node/get_type_description",
        "publisher /parameter_events",
    )
    (tmp_path / "k/enclaves/e").mkdir(parents=True)
    with RosNetwork({**os.environ, **environment(*allowed)}) as network:
        with pytest.raises(RefusedError, match="does not exist"):
            network.node(Path("/nowhere"), "/e")
        node = network.node(None, "/e")
        assert node.ask("TRY", "ros_publish", "/a") == ("ALLOWED", "")
        assert node.ask("TRY", "ros_publish", "/b") == ("DENIED", "failed to create publisher of /b")
        assert node.ask("TRY", "ros_read", "/n")[0] == "DENIED"
        assert node.ask("KEEP", "k", "ros_publish", "/a") == ("ALLOWED", "")
        assert node.ask("NODE", "node", "/x/")[0] == "ALLOWED"
        assert node.ask("NODE", "other", "/x/")[0] == "DENIED"
        with pytest.raises(ProcessFailedError, match="KeyError"):
            node.ask("SING")
        with pytest.raises(ProcessDiedError):
            node.ask("TRY", "ros_publish", "/dies")


def test_a_machine_without_util_linux_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_network, "UNSHARE", ("/nowhere/unshare",))
    with pytest.raises(MissingVendorError, match="No such file"), RosNetwork({**os.environ, **environment()}):
        pass
