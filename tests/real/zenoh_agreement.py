# SPDX-License-Identifier: Apache-2.0
"""Compares the model of Zenoh's access control with a real router, on random configurations."""

from __future__ import annotations

import os
import random
import tempfile
from collections.abc import Iterator
from itertools import count
from pathlib import Path

from keymint_ros2_zenoh.decision import AccessModel, Link
from keymint_ros2_zenoh.documents.configuration import AccessControl, Flow, Message
from keymint_ros2_zenoh.vendors import zenoh_processes
from keymint_ros2_zenoh.vendors.loopback import free_port
from keymint_ros2_zenoh.vendors.zenoh_processes import LoggedDecision, ZenohError, ZenohProcess, ZenohSystem

from .zenoh_configurations import FENCE, NAMES, ROUTER, Identities, random_access_control, random_key_expr
from .zenoh_system import ZenohTestSystem

_ATTEMPTS = 3


def disagreements(configurations: int, keys: int, seed: int) -> Iterator[tuple[bool, str]]:
    """Yield for each decision of a real router whether it allows, and a text if the model decides differently.

    Args:
        configurations: how many random routers.
        keys: literal keys, and as many with wildcards, for each of three sessions.
        seed: of the random numbers.

    Raises:
        AssertionError: the router did not decide on something that a session sent.
    """
    randomly = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder, ZenohTestSystem(os.environ) as system:
        identities = Identities.new(Path(folder))
        identities.issue("router", ROUTER, server=True)
        for number, name in enumerate(NAMES):
            identities.issue(f"node{number}", name)
        router, sessions = system.start(log=zenoh_processes.FILTER), system.start()
        numbers = count()
        for number in range(configurations):
            control = random_access_control(randomly)
            model = AccessModel(control)
            port = _open_router(system, router, identities, control)
            for node, name in enumerate(NAMES):
                file = system.file("session.json5", identities.session(port, f"node{node}"))
                sessions.open(name, file, {})
                link = Link(name, interface="lo", protocol="tls", zid=sessions.ask("zid", session=name))
                literal = list(dict.fromkeys(random_key_expr(randomly, literal=True) for _ in range(keys)))
                wild = list(dict.fromkeys(random_key_expr(randomly) for _ in range(keys)))
                fence = f"{FENCE}/{next(numbers)}"
                _send(sessions, name, literal, wild, fence)
                for each in _decided(router, model.on(link).watched, link.zid, literal, wild, fence):
                    yield _compared(model, link, each, f"seed {seed}, configuration {number}: {control}")
                sessions.ask("close", session=name)
            router.ask("close", session="router")


def _open_router(system: ZenohSystem, router: ZenohProcess, identities: Identities, control: AccessControl) -> int:
    """Open a router on a free port; another program may take the port before it does."""
    for attempt in count():
        port = free_port()
        file = system.file("router.json5", identities.router(port, control))
        try:
            router.open("router", file, {})
        except ZenohError:
            if attempt == _ATTEMPTS:
                raise
        else:
            return port
    raise AssertionError


def _send(sessions: ZenohProcess, name: str, literal: list[str], wild: list[str], fence: str) -> None:
    """Let a session send all messages, and declare a publisher on the fence last."""
    sessions.ask("publishers", session=name, keys=literal)
    sessions.ask("put", session=name, samples=[(key, "x") for key in wild])
    sessions.ask("delete", session=name, keys=wild)
    sessions.ask("subscribe", session=name, keys={f"{name} {key}": key for key in wild})
    sessions.ask("send_queries", session=name, keys=wild)  # before its own queryables, which would answer alone
    sessions.ask("answer", session=name, keys=wild, text="x")
    sessions.ask("watch", session=name, keys={f"{name} token {key}": key for key in wild})
    sessions.ask("publishers", session=name, keys=[fence])


def _decided(
    router: ZenohProcess, flows: frozenset[Flow], zid: str, literal: list[str], wild: list[str], fence: str
) -> list[LoggedDecision]:
    """Return what the router decided on the messages of a session; one decision if no subject matches it."""
    found = router.await_decisions(zid, fence)
    for_all = [each for each in found if not each.message]
    if for_all:
        return for_all
    if missing := _expected(flows, literal, wild) - {(each.message, each.flow, each.key) for each in found}:
        raise AssertionError(f"the router did not decide on {sorted(missing)[:3]}")
    return found


def _expected(flows: frozenset[Flow], literal: list[str], wild: list[str]) -> set[tuple[str, str, str]]:
    """Return the least that the router must log of these flows."""
    every = {(message, flow, key) for message in Message for flow in flows for key in literal}
    sent = set(Message) - {Message.REPLY, Message.LIVELINESS_TOKEN}
    return every | {(message, flow, key) for message in sent for flow in flows & {Flow.INGRESS} for key in wild}


def _compared(model: AccessModel, link: Link, decision: LoggedDecision, origin: str) -> tuple[bool, str]:
    """Compare a decision; one for all messages of a link with the model's on any message."""
    message, flow = Message(decision.message or Message.PUT), Flow(decision.flow or Flow.INGRESS)
    modelled = model.on(link).decide(message, flow, decision.key or FENCE)
    if modelled.allowed == decision.allowed:
        return decision.allowed, ""
    return decision.allowed, f"{decision}, but the model says {modelled.reason}; {origin}"
