# SPDX-License-Identifier: Apache-2.0
"""What a governance document makes of an endpoint, by the standard and by each vendor."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator, DomainAccess
from keymint_ros2_dds.decision.semantics import FASTDDS_2_9, OMG, VARIATIONS, explain
from keymint_ros2_dds.reading import signed_governance
from keymint_ros2_dds.reading.signed_permissions import read

from .documents import NOW, SUBJECT, criteria, document, grant, rule

C, F, O = "cyclonedds-0.10 cyclonedds-11", "fastdds-2.11 fastdds-2.9 fastdds-3.3", "omg"  # noqa: E741 - the standard
PERMISSIONS = document(grant(rule("allow", criteria("publish", "rt/x")), rule("deny", criteria("subscribe", "rt/z"))))
NOBODY = document(grant(rule("deny", criteria("publish", "rt/x"))))


def topic(expression: str, *, read: bool = True, write: bool = True) -> str:
    flags = {"read": str(read).lower(), "write": str(write).lower()}
    return (
        f"<topic_rule><topic_expression>{expression}</topic_expression>"
        "<enable_discovery_protection>true</enable_discovery_protection>"
        "<enable_liveliness_protection>true</enable_liveliness_protection>"
        f"<enable_read_access_control>{flags['read']}</enable_read_access_control>"
        f"<enable_write_access_control>{flags['write']}</enable_write_access_control>"
        "<metadata_protection_kind>ENCRYPT</metadata_protection_kind>"
        "<data_protection_kind>ENCRYPT</data_protection_kind></topic_rule>"
    )


def ruling(*topics: str, domains: str = "<id>0</id>", join: str = "true") -> str:
    return (
        f"<dds><domain_access_rules><domain_rule><domains>{domains}</domains>"
        "<allow_unauthenticated_participants>false</allow_unauthenticated_participants>"
        f"<enable_join_access_control>{join}</enable_join_access_control>"
        "<discovery_protection_kind>ENCRYPT</discovery_protection_kind>"
        "<liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>"
        "<rtps_protection_kind>ENCRYPT</rtps_protection_kind>"
        f"<topic_access_rules>{''.join(topics)}</topic_access_rules></domain_rule></domain_access_rules></dds>"
    )


def allowing(text: str, action: str = "publish", name: str = "rt/x", content: bytes = PERMISSIONS) -> str:
    """Return who allows it."""
    return " ".join(sorted(each for each in VARIATIONS if allows(VARIATIONS[each], text, action, name, content)))


def allows(variation, text: str, action: str, name: str, content: bytes = PERMISSIONS) -> bool:
    evaluator = DocumentEvaluator(read(content), SUBJECT, NOW, 0, variation)
    return (
        DomainAccess(signed_governance.read(text.encode()), 0, variation.semantics)
        .decide(evaluator, action, name)
        .allowed
    )


JOIN = "enable_join_access_control"
ALL = f"{C} {F} {O}"
CLOSED = topic("*")
CASES = [
    (ruling(CLOSED), "publish", "rt/x", ALL),
    (ruling(CLOSED), "subscribe", "rt/x", ""),
    (ruling(topic("rt/x", read=False), CLOSED), "subscribe", "rt/x", ALL),
    (ruling(topic("rt/y", read=False), CLOSED), "subscribe", "rt/x", ""),
    (ruling(CLOSED, topic("rt/x", read=False)), "subscribe", "rt/x", ""),
    (ruling(topic("rt/y")), "publish", "rt/x", ""),
    (ruling(CLOSED, domains="<id>1</id>"), "publish", "rt/x", ""),
    (ruling(CLOSED, domains="<id_range><min>0</min></id_range>"), "publish", "rt/x", ALL),
    (ruling(CLOSED, domains="<id_range><max>3</max></id_range>"), "publish", "rt/x", f"{F} {O}"),
    (ruling(CLOSED, domains="<id>231</id><id>0</id>"), "publish", "rt/x", f"{F} {O}"),
    (ruling(CLOSED).replace(f"<{JOIN}>true</{JOIN}>", ""), "publish", "rt/x", ""),
    (ruling(topic("rt/a", write=False), CLOSED), "publish", "rt/?", F),
    (ruling(topic("rt/a", write=False), CLOSED), "publish", "*", F),
    (ruling(topic("rt/[a]", write=False), CLOSED), "publish", "rt/]", C),
]  # fmt: skip


@pytest.mark.parametrize(("text", "action", "name", "expected"), CASES, ids=[str(n) for n in range(len(CASES))])
def test_who_allows(text: str, action: str, name: str, expected: str) -> None:
    assert allowing(text, action, name) == expected


def test_who_joins_without_a_rule() -> None:
    # Nobody publishes what is controlled; what is open may be had by whoever is let in.
    open_ = ruling(topic("rt/x", write=False), CLOSED)
    assert allowing(open_, content=NOBODY) == f"{C} {O}"
    assert allowing(ruling(CLOSED, join="false"), content=NOBODY) == ""


def test_names_are_compared_both_ways_by_fast_dds_and_the_row_says_so() -> None:
    text = ruling(topic("rt/a", write=False), CLOSED)
    (found,) = explain(lambda asked: allows(asked, text, "publish", "rt/?"), FASTDDS_2_9)
    assert found.row == "20"


def test_lines_count_from_the_beginning_of_the_file() -> None:
    text = ruling("\n", topic("rt/x", write=False), "\n", CLOSED)
    found = signed_governance.read(text.encode(), "g.p7s", 10)
    assert str(found.place(found.domain_rules[0].topic_rules[0].line)) == "g.p7s:12"
    evaluator = DocumentEvaluator(read(PERMISSIONS), SUBJECT, NOW, 0, OMG)
    decision = DomainAccess(found, 0, OMG.semantics).decide(evaluator, "publish", "rt/x")
    assert decision.allowed
    assert str(decision.where) == "g.p7s:12"
