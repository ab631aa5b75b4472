# SPDX-License-Identifier: Apache-2.0
"""``keymint verify`` reports each endpoint of a service, action or parameter permitted against the policy.

Documents get endpoints of random composites, and are signed properly. The expected findings are derived from the ROS
names alone. In full, with what was counted::

    KEYMINT_FULL=1 .venv/bin/python -m pytest -s tests/real/test_half_services.py
"""

from __future__ import annotations

import random
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from keymint_ros import profile_type

import comarmor
from tests.conftest import CHECKOUT, Outcome
from tests.effort import FULL, tries

from .conftest import REAL_TRANSPORTS, usable_transport

SIMULATED = ("omg", "cyclonedds-0.10", "fastdds-2.9")
READ = ("describe_parameters", "get_parameters", "get_parameter_types", "list_parameters")
WRITE = ("set_parameters", "set_parameters_atomically")
SUBJECTS = ("/talker", "/listener")
SERVICES = tuple(f"{node}/{name}" for node in SUBJECTS for name in (*READ, *WRITE))
DOCUMENTS = tries(2, 100)


@dataclass(frozen=True)
class Endpoint:
    """One of the two topics of one side of a service."""

    service: str
    permission: str
    action: str

    @property
    def topic(self) -> str:
        request = (self.permission == "ros_call") == (self.action == "publish")
        return f"rq{self.service}Request" if request else f"rr{self.service}Reply"


ENDPOINTS = tuple(
    Endpoint(service, permission, action)
    for service in SERVICES
    for permission in ("ros_call", "ros_execute")
    for action in ("publish", "subscribe")
)


@pytest.fixture(autouse=True)
def real_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH")


@pytest.fixture(params=[*SIMULATED, *REAL_TRANSPORTS])
def transport(request: pytest.FixtureRequest) -> str:
    """A transport, simulated or real."""
    if request.param not in SIMULATED:
        usable_transport(request.param)
    return request.param


@pytest.fixture
def permitting(keymint: Callable[..., Outcome], tmp_path: Path) -> Callable[..., Outcome]:
    """Permit endpoints in the documents of subjects, install them, and verify."""
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws").code == 0
    paths = {subject: tmp_path / f"ws/build{subject}/permissions.xml" for subject in SUBJECTS}
    plain = {subject: path.read_text() for subject, path in paths.items()}

    def run(added: dict[str, set[Endpoint]], transport: str) -> Outcome:
        for subject, path in paths.items():
            lists = "".join(
                f"<{action}><topics><topic>{'</topic><topic>'.join(sorted(topics))}</topic></topics></{action}>"
                for action in ("publish", "subscribe")
                if (topics := {each.topic for each in added.get(subject, ()) if each.action == action})
            )
            rule = f"<allow_rule><domains><id>0</id></domains>{lists}</allow_rule>" if lists else ""
            path.write_text(re.sub(r"(</validity>)", rf"\1{rule}", plain[subject]))
        outcome = keymint("install", "--no-prove", "-w", "ws")
        assert outcome.code == 0, outcome.err
        return keymint("verify", "-w", "ws", "-i", transport, "--json", "--limit", "10000")

    return run


def expected(policy: comarmor.Policy, subject: str, added: set[Endpoint]) -> set[Endpoint]:
    """Return the endpoints of the sides of a service that the policy does not allow."""
    return {each for each in added if not policy.decide(subject, "ros_service", each.permission, each.service).allowed}


def found(outcome: Outcome) -> dict[str, set[Endpoint]]:
    """Return the endpoints of all false positives."""
    (result,) = outcome.document["result"]["transports"]
    by_subject: dict[str, set[Endpoint]] = {subject: set() for subject in SUBJECTS}
    for finding in result["findings"]:
        assert finding["error"] == "false-positive"
        edge = finding["edge"]
        name, permission, subject = edge["object"], edge["permission"], edge["subject"]
        if edge["kind"] == "topic":
            by_subject[subject] |= {each for each in ENDPOINTS if (each.topic, each.action) == (name, permission)}
        elif edge["kind"] == "ros_service":
            by_subject[subject] |= {each for each in ENDPOINTS if (each.service, each.permission) == (name, permission)}
        else:
            names = {"ros_read": READ, "ros_write": WRITE}[permission]
            services = {f"{name}/{service}" for service in names}
            by_subject[subject] |= {e for e in ENDPOINTS if e.service in services and e.permission == "ros_call"}
    assert result["confusion"]["false_positive"] == len(result["findings"])
    return by_subject


@pytest.fixture
def policy() -> comarmor.Policy:
    return comarmor.load(CHECKOUT / "examples/talker_listener", library=profile_type.library("jazzy"))


def test_a_request_topic_alone_lets_a_subject_write_parameters(
    permitting: Callable[..., Outcome], transport: str
) -> None:
    outcome = permitting({"/talker": {Endpoint("/listener/set_parameters", "ros_call", "publish")}}, transport)
    assert outcome.code == 3
    (result,) = outcome.document["result"]["transports"]
    (finding,) = result["findings"]
    assert finding["request"] == "/talker publish rq/listener/set_parametersRequest"
    assert result["confusion"]["false_positive"] == 1


def test_a_fully_permitted_service_is_reported_once(permitting: Callable[..., Outcome], transport: str) -> None:
    both = {Endpoint("/listener/set_parameters", "ros_call", action) for action in ("publish", "subscribe")}
    outcome = permitting({"/talker": both}, transport)
    (result,) = outcome.document["result"]["transports"]
    assert [each["request"] for each in result["findings"]] == ["/talker ros_call /listener/set_parameters"]


def test_every_endpoint_is_reported(
    permitting: Callable[..., Outcome], policy: comarmor.Policy, transport: str, capsys: pytest.CaptureFixture[str]
) -> None:
    chance = random.Random(f"half services on {transport}")
    injected = 0
    for _ in range(DOCUMENTS):
        added = {subject: set(chance.sample(ENDPOINTS, chance.randint(0, 6))) for subject in SUBJECTS}
        wanted = {subject: expected(policy, subject, endpoints) for subject, endpoints in added.items()}
        outcome = permitting(added, transport)
        assert found(outcome) == wanted
        assert outcome.code == (3 if any(wanted.values()) else 0)
        injected += sum(map(len, wanted.values()))
    if FULL:
        with capsys.disabled():
            sys.stdout.write(f"\n{transport}: {DOCUMENTS} documents, {injected} endpoints too many, 0 unseen\n")
