# SPDX-License-Identifier: Apache-2.0
"""Measure what the file of one Zenoh router costs that holds the rights of N enclaves: build, start, and each message.

usage: python benchmarks/zenoh_router.py [--sizes 10,100,1000] [--messages N] [--repeat 3]

Beside each measurement runs its baseline: the build of the same policy for DDS; and a router, with the same
certificates, whose access control has one rule, which allows everything to two enclaves. Compare the ratios. Builds
are measured in processor time, the router in time: it has all of a quiet machine, or a part of a busy one.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from fleet import KEYMINT, Spent, policy, spent
from keymint_ros2_zenoh.documents import json5
from keymint_ros2_zenoh.documents.configuration import TLS, Flow, Message
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY
from keymint_ros2_zenoh.vendors import loopback
from keymint_ros2_zenoh.vendors.loopback import free_port
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohProcess, ZenohSystem

SENDER, RECEIVER = "robot0/talker", "robot0/listener"
OPEN = {
    "enabled": True,
    "default_permission": "deny",
    "rules": [
        {"id": "all", "messages": list(Message), "flows": list(Flow), "permission": "allow", "key_exprs": ["**"]}
    ],
    "subjects": [{"id": "two", "cert_common_names": [f"/{SENDER}", f"/{RECEIVER}"]}],
    "policies": [{"rules": ["all"], "subjects": ["two"]}],
}
"""The baseline's access control."""
_TRIES = 100
"""How often the first message is sent, until the subscription has reached the sender."""


@dataclass(frozen=True, slots=True)
class Running:
    """The time that a router needed to start, and messages per second from one enclave to another."""

    start: float
    rate: float


def build(folder: Path, source: Path, transport: str) -> tuple[Path, float]:
    """Create a workspace for a transport and build it; return it, and the processor time of the build."""
    workspace = folder / transport
    _run("init", workspace, "--policy", source, "--transport", transport)
    _run("create", "--all", "-w", workspace)
    return workspace, _run("build", "-w", workspace).cpu


def without_rights(system: ZenohSystem, file: Path) -> Path:
    """Return a router's file with the baseline's access control."""
    document = json5.parse(file.read_bytes(), str(file))[0]
    return system.file("bare.json5", json.dumps({**document, "access_control": OPEN}).encode())


def route(system: ZenohSystem, install: Path, messages: int, file: Path) -> Running:
    """Start a router with the certificates of an install space and let one enclave publish to another.

    Args:
        system: the processes.
        install: the install space.
        messages: how many messages, on as many keys.
        file: the router's configuration.
    """
    process, sessions, port = system.start(), system.start(), str(free_port())
    ports = {"7447": port}
    enclaves = install / "enclaves"
    changes = loopback.router_changes(["tls/127.0.0.1:7447"], ports) | _paths("listen", enclaves / "zenoh_router")
    process.ask("put", session="router", samples=[])  # starts the interpreter, loads the library
    begin = time.perf_counter()
    process.open("router", file, changes)
    start = time.perf_counter() - begin
    for name in (SENDER, RECEIVER):
        changes = loopback.session_changes(["tls/localhost:7447"], ports) | _paths("connect", enclaves / name)
        sessions.open(name, enclaves / name / "session.json5", changes)
    rate = _rate(sessions, messages)
    process.reap()
    sessions.reap()
    return Running(start, rate)


def _rate(sessions: ZenohProcess, messages: int) -> float:
    """Return messages per second on the keys of a topic that all nodes may publish and subscribe."""
    key = "0/parameter_events/rcl_interfaces::msg::dds_::ParameterEvent_"
    sessions.ask("subscribe", session=RECEIVER, keys={"box": f"{key}/*"})
    for number in range(_TRIES):
        text = f"warm {number}"
        sessions.ask("put", session=SENDER, samples=[(f"{key}/warm", text)])
        if any(each == text for _, each in sessions.ask("received", names=["box"], last=text, wait=0.1)["box"]):
            break
    samples = [(f"{key}/RIHS{number}", f"text {number}") for number in range(messages)]
    begin = time.perf_counter()
    sessions.ask("put", session=SENDER, samples=samples)
    found = sessions.ask("received", names=["box"], last=samples[-1][1], wait=30.0)["box"]
    seconds = time.perf_counter() - begin
    if sum(text.startswith("text") for _, text in found) != messages:
        raise SystemExit(f"{len(found)} of {messages} messages arrived")
    return messages / seconds


def _paths(role: str, folder: Path) -> dict[str, object]:
    names = {"root_ca_certificate": IDENTITY_CA, f"{role}_certificate": CERTIFICATE, f"{role}_private_key": KEY}
    return {f"{TLS}/{name}": str(folder / file) for name, file in names.items()}


def _run(*words: object) -> Spent:
    return spent(*KEYMINT, *map(str, words), "-q")


def measure(size: int, messages: int, repeat: int) -> None:
    """Measure a size, and print a row."""
    with tempfile.TemporaryDirectory() as scratch, ZenohSystem(os.environ) as system:
        source = Path(scratch) / "policy.xml"
        source.write_text(policy(size, own=True))
        _, dds = build(Path(scratch), source, "dds")
        workspace, zenoh = build(Path(scratch), source, "zenoh")
        _run("install", "--no-prove", "-w", workspace)
        install = workspace / "install"
        router = install / "zenoh/router.json5"
        bare_router = without_rights(system, router)
        pairs = [
            (route(system, install, messages, router), route(system, install, messages, bare_router))
            for _ in range(repeat)
        ]
        start, bare_start = (min(run.start for run in runs) for runs in zip(*pairs, strict=True))
        rate, bare_rate = (max(run.rate for run in runs) for runs in zip(*pairs, strict=True))
        document = router.stat().st_size
        print(
            f"| {size} | {document / 1000:,.0f} kB | {zenoh / size * 1000:.1f} ms | {zenoh / dds:.2f} "
            f"| {start * 1000:,.0f} ms | {start / bare_start:.1f} | {rate:,.0f}/s | {rate / bare_rate:.2f} |",
            flush=True,
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", default="10,100,1000")
    parser.add_argument("--messages", type=int, default=20_000)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    print("| enclaves | file | build / N | build / DDS | start | start / bare | messages | messages / bare |")
    print("|---|---|---|---|---|---|---|---|")
    for size in map(int, options.sizes.split(",")):
        measure(size, options.messages, options.repeat)


if __name__ == "__main__":
    main()
