# SPDX-License-Identifier: Apache-2.0
"""What each permission needs at the router: with all of it a ROS operation works, and without any part it does not.

Sessions do what rmw_zenoh does: declared publishers and queriers, and for ``transient_local`` the advanced publishers
and subscribers of Zenoh's extension.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from keymint_ros2_zenoh.lowering.permissions import SLOTS, Place

from tests.plugins.keymint_ros2_zenoh.install_spaces import NEEDED, InstallSpace, key

from .zenoh_network import RealNetwork, real_network

pytestmark = [pytest.mark.zenoh, pytest.mark.usefixtures("zenoh_library")]

KEY = "0/x/type/hash"
_TRIES = 8
"""How often an operation is repeated that may closely follow declarations."""
_NUMBERS = count()


def publish(network: RealNetwork, one: str, other: str) -> bool:
    """Publish with a declared publisher. Its first sample does not count: it does not know yet who subscribes."""
    box = f"box{next(_NUMBERS)}"
    network.sessions.ask("subscribe", session=other, keys={box: KEY})
    for number in range(_TRIES):
        text = f"{box} {number}"
        network.sessions.ask("publish", session=one, samples=[(KEY, text)])
        arrived = network.sessions.ask("received", names=[box], last=text, wait=0.2)[box]
        if number and any(each == text for _, each in arrived):
            return True
    return False


def late(network: RealNetwork, one: str, other: str) -> bool:
    """Publish a sample before there is a subscriber for it: a later one on the same link has arrived elsewhere."""
    box = f"box{next(_NUMBERS)}"
    fence = f"fence of {box}"
    network.sessions.ask("subscribe", session=other, keys={fence: KEY})
    network.sessions.ask("publish_late", session=one, key=KEY, text=box)
    for _ in range(_TRIES):
        network.sessions.ask("publish", session=one, samples=[(KEY, fence)])
        arrived = network.sessions.ask("received", names=[fence], last=fence, wait=0.3)[fence]
        if any(text == fence for _, text in arrived):
            break
    for number in range(_TRIES):
        name = f"{box} {number}"
        network.sessions.ask("subscribe_late", session=other, name=name, key=KEY)
        arrived = network.sessions.ask("received", names=[name], last=box, wait=0.3)[name]
        if any(text == box for _, text in arrived):
            return True
    return False


def call(network: RealNetwork, one: str, other: str) -> bool:
    """Call with a declared querier. Its first query does not count: it does not know yet who answers."""
    network.sessions.ask("answer", session=other, keys=[KEY], text="yes")
    answers = [network.sessions.ask("queriers", session=one, keys=[KEY], wait=0.3)[KEY] for _ in range(_TRIES)]
    return ["yes"] in answers[1:]


OPERATIONS: dict[str, tuple[str, str, Callable[[RealNetwork, str, str], bool]]] = {
    "publish": ("publish", "subscribe", publish),
    "late": ("publish", "subscribe", late),
    "call": ("call", "execute", call),
}
PARTS: dict[str, list[tuple[str, str, str, str]]] = {
    "publish": [
        ("/one", "put", "ingress", ""),
        ("/one", "declare_subscriber", "egress", ""),
        ("/other", "declare_subscriber", "ingress", ""),
        ("/other", "put", "egress", ""),
    ],
    "late": [
        ("/one", "reply", "ingress", ""),
        ("/one", "declare_queryable", "ingress", "/@adv/**"),
        ("/one", "query", "egress", "/@adv/**"),
        ("/other", "reply", "egress", ""),
        ("/other", "query", "ingress", "/@adv/**"),
    ],
    "call": [
        ("/one", "query", "ingress", ""),
        ("/one", "reply", "egress", ""),
        ("/one", "declare_queryable", "egress", ""),
        ("/other", "declare_queryable", "ingress", ""),
        ("/other", "reply", "ingress", ""),
        ("/other", "query", "egress", ""),
    ],
}
"""What operations need, with the subject whose link it is on."""


def without(space: InstallSpace, subject: str, message: str, flow: str, suffix: str) -> dict[str, Any]:
    """Return the router's access control without a message in a flow on the keys of a subject."""
    rules = space.router()["access_control"]["rules"]
    for rule in rules:
        if (
            rule["id"].startswith(f"{subject} ")
            and rule["flows"] == [flow]
            and rule["key_exprs"] == [key("x") + suffix]
        ):
            rule["messages"].remove(message)
    return {"rules": [rule for rule in rules if rule["messages"]], "policies": _policies(rules)}


def _policies(rules: list[dict[str, Any]]) -> list[dict[str, Any]]:
    kept = [rule["id"] for rule in rules if rule["messages"]]
    return [
        {"rules": [name for name in kept if name.startswith(f"{subject} ")], "subjects": [subject]}
        for subject in ("/one", "/other")
    ]


def works(space: InstallSpace, operation: str, changes: dict[str, Any] | None = None) -> bool:
    with real_network(space) as network:
        network.router(changes)
        return OPERATIONS[operation][2](network, network.session("one"), network.session("other"))


@pytest.fixture(params=list(OPERATIONS))
def operation(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def space(operation: str, tmp_path: Path) -> InstallSpace:
    one, other, _ = OPERATIONS[operation]
    return InstallSpace(tmp_path / "install", {"/one": [(one, key("x"))], "/other": [(other, key("x"))]})


def test_what_permissions_need_is_enough(operation: str, space: InstallSpace) -> None:
    assert works(space, operation)


@pytest.mark.parametrize(
    ("operation", "part"),
    [(operation, part) for operation, parts in PARTS.items() for part in parts],
    indirect=["operation"],
)
def test_each_part_of_it_is_needed(operation: str, space: InstallSpace, part: tuple[str, str, str, str]) -> None:
    assert not works(space, operation, {"access_control": without(space, *part)})


def test_the_compilers_table_is_the_measured_one() -> None:
    suffixes = {Place.DATA: "", Place.ADVANCED: "/@adv/**"}
    compiled = {
        permission: {(slot.message.value, slot.flow.value, suffixes[slot.place]) for slot in slots}
        for permission, slots in SLOTS.items()
    }
    measured = {
        f"ros_{permission}": {(message, *flows, suffix) for messages, flows, suffix in parts for message in messages}
        for permission, parts in NEEDED.items()
    }
    assert compiled == measured
