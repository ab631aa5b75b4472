# SPDX-License-Identifier: Apache-2.0
"""What stands in for commands of ROS 2 on pages that the suite follows: ``python -m tests.stand_ins KIND …``."""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parent.parent
_PARAMETERS = (
    "describe_parameters", "get_parameter_types", "get_parameters", "get_type_description", "list_parameters",
    "set_parameters", "set_parameters_atomically",
)  # fmt: skip


def keystore(folder: str, policy: str) -> None:
    """Make a keystore as ``ros2 security generate_artifacts`` does."""
    from tests import sros2_keystore

    sros2_keystore.make(Path(folder), Path(policy).read_text())


def domain() -> None:
    """Print a configuration of Cyclone DDS that nobody else uses, and hold its ports until the end."""
    from keymint_ros2_dds.vendors.participants import free_ports

    from tests.real.test_discover import configuration

    with free_ports() as first_port:
        _say(configuration(first_port))
        signal.pause()


def node(name: str, *edges: str) -> None:
    """Be an unsecured node of rclcpp, by Cyclone DDS, until the end; an edge is ``publish:/topic``, for example."""
    from tests.real.unsecured import Participant

    topics = [("publish", "rt/rosout"), ("publish", "rt/parameter_events"), ("subscribe", "rt/parameter_events")]
    topics += [("publish", "ros_discovery_info"), ("subscribe", "ros_discovery_info")]
    for service in _PARAMETERS:
        topics += [("subscribe", f"rq{name}/{service}Request"), ("publish", f"rr{name}/{service}Reply")]
    for edge in edges:
        permission, _, topic = edge.partition(":")
        topics.append((permission, f"rt{topic}"))
    what: dict[str, object] = {
        "user_data": f"enclave={name};",
        "edges": [(permission, topic, []) for permission, topic in topics],
    }
    participant = Participant(0, what)
    _say("ready")
    signal.pause()
    del participant


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


KINDS: Mapping[str, Callable[..., None]] = {"keystore": keystore, "domain": domain, "node": node}


def stand_in(*words: str) -> str:
    """Return the command that runs something of this module."""
    return (
        f"PYTHONPATH={shlex.quote(str(CHECKOUT))} {shlex.quote(sys.executable)} -m tests.stand_ins {shlex.join(words)}"
    )


def started(*words: str, variable: str = "_") -> str:
    """Return the command that starts something of this module, and waits for its first line."""
    return f"IFS= read -r {variable} < <({stand_in(*words)}) && export {variable}"


_RUN = "ros2 run demo_nodes_cpp"
STAND_INS = {
    "ros2 security generate_artifacts -k demo_keystore -p policy.xml": stand_in(
        "keystore", "demo_keystore", "policy.xml"
    ),
    "source /opt/ros/jazzy/setup.bash": started("domain", variable="CYCLONEDDS_URI"),
    f"{_RUN} talker --ros-args --enclave /talker": started("node", "/talker", "publish:/chatter"),
    f"{_RUN} listener --ros-args --enclave /listener": started("node", "/listener", "subscribe:/chatter"),
    f"{_RUN} talker --ros-args --enclave /laptop -r __node:=laptop": started("node", "/laptop", "publish:/chatter"),
}
"""By a command that the suite cannot run, one that does the same in the shell of the reader."""

if __name__ == "__main__":
    KINDS[sys.argv[1]](*sys.argv[2:])
