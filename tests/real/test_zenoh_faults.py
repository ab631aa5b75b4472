# SPDX-License-Identifier: Apache-2.0
"""Injected faults in the router's file against a real router: whom it allows other messages than before."""

from __future__ import annotations

import json
import os
from collections.abc import Callable

import pytest
from keymint_ros2_zenoh.vendors import zenoh_processes
from keymint_ros2_zenoh.vendors.loopback import free_port
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohError, ZenohSystem

from tests.effort import FULL
from tests.keymint.examine.fault import Fault
from tests.keymint.examine.fault_keystores import SUBJECTS, Keystore
from tests.keymint.examine.fault_workspaces import Bench
from tests.keymint.examine.faults_of_zenoh import FAULTS, ROUTER, read

from .test_faults import real_bench  # noqa: F401 - a fixture
from .zenoh_system import ZenohTestSystem

pytestmark = [pytest.mark.zenoh, pytest.mark.usefixtures("zenoh_library")]

SETTINGS = ("default", "no deny")
"""Settings that access control decides and logs; others decide who gets a link at all."""
FENCE = "keymint/fence"
_TOPICS = ("chatter", "chatterx", "status/secret", "status/ok", "tf", "cmd", "image", "image2", "add", "addx", "cmdx",
           "imag2", "zz", "other/chatter", "other/cmd", "other/add", "other/image", "other/tf",
           "other/status/ok")  # fmt: skip
KEYS = (
    *(f"0/{name}/type/hash" for name in _TOPICS),
    "1/chatter/type/hash",
    "0/chatter/type/hash/@adv/pub/a/b/_",
    *(f"@ros2_lv/0/zid/0/1/MP/{subject.replace('/', '%')}/%/node/%chatter/type/hash/qos" for subject in SUBJECTS),
)
Decisions = set[tuple[str, str, str, str, bool]]
"""What the router decides: holder of a certificate, message, flow, key, whether it is allowed."""


def judged(fault: Fault) -> bool:
    label = fault.name.partition(": ")[2]
    return fault.kind == 22 and fault.name != "no file" and (not label or label in SETTINGS)


JUDGED = [fault for fault in FAULTS if judged(fault)]


def decisions(keystore: Keystore, system: ZenohSystem, stolen: bool) -> Decisions:
    """Let a session of each enclave, which restrains itself by nothing, ask the router of a keystore."""
    router, sessions = system.start(log=zenoh_processes.FILTER), system.start()
    document = read((keystore.ws / ROUTER).read_bytes())
    port = free_port()
    document["listen"] = {"endpoints": [f"tls/127.0.0.1:{port}"]}
    document["transport"]["link"]["tls"]["verify_name_on_connect"] = False
    router.open("router", system.file("router.json5", json.dumps(document).encode()), {})
    holders = {subject: keystore.enclave(subject) for subject in SUBJECTS if keystore.enclave(subject).exists()}
    if stolen:
        holders |= {f"{subject} then": keystore.stage(0, subject) for subject in SUBJECTS}
    found: Decisions = set()
    for number, (holder, folder) in enumerate(holders.items()):
        if not (folder / "session.json5").exists():
            continue
        own = read((folder / "session.json5").read_bytes())
        own["connect"] = {"endpoints": [f"tls/127.0.0.1:{port}"]}
        own["access_control"] = {"enabled": False}
        tls = own["transport"]["link"]["tls"]
        tls.update(verify_name_on_connect=False, root_ca_certificate=str(folder / "identity_ca.cert.pem"))
        tls.update(connect_certificate=str(folder / "cert.pem"), connect_private_key=str(folder / "key.pem"))
        name = f"session{number}"
        try:
            sessions.open(name, system.file(f"{name}.json5", json.dumps(own).encode()), {})
        except ZenohError:
            continue
        zid, fence = sessions.ask("zid", session=name), f"{FENCE}/{number}"
        sessions.ask("publishers", session=name, keys=[*KEYS, fence])
        for each in router.await_decisions(zid, fence):
            if each.key != fence:
                found.add((holder, each.message, each.flow, each.key, each.allowed))
        sessions.ask("close", session=name)
    router.ask("close", session="router")
    return found


@pytest.fixture(scope="module")
def sound(real_bench: Bench) -> Callable[[str], Decisions]:  # noqa: F811
    """Return what a router decides in workspaces without faults."""
    known: dict[str, Decisions] = {}

    def found(kind: str) -> Decisions:
        if kind not in known:
            with ZenohTestSystem(os.environ) as system:
                known[kind] = decisions(real_bench.copy(kind), system, "revoked" in kind)
        return known[kind]

    return found


@pytest.mark.parametrize("fault", JUDGED if FULL else JUDGED[::32], ids=lambda fault: fault.id)
def test_a_router_decides_as_the_table_says(
    real_bench: Bench,  # noqa: F811
    sound: Callable[[str], Decisions],
    zenoh_system: ZenohSystem,
    fault: Fault,
) -> None:
    before = sound(fault.workspace)
    assert len(before) > 100
    keystore = real_bench.copy(fault.workspace)
    fault.apply(keystore)
    after = decisions(keystore, zenoh_system, "revoked" in fault.workspace)
    assert (after != before) == fault.decides, sorted(after ^ before)[:5]
