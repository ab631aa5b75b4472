# SPDX-License-Identifier: Apache-2.0
"""Each deviation of a vendor, by the row of the table in docs/vendors.md that it models."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from keymint_ros2_dds.decision.semantics import OMG, VARIATIONS, explain
from keymint_ros2_dds.reading.signed_permissions import read

from .documents import NOW, SUBJECT, criteria, decide, document, grant, rule

C10, C11, F29, F211, O = "cyclonedds-0.10", "cyclonedds-11", "fastdds-2.9", "fastdds-2.11 fastdds-3.3", "omg"  # noqa: E741
C, F = f"{C10} {C11}", f"{F29} {F211}"
X = criteria("publish", "rt/x")
ALLOW_X = rule("allow", X)
PAST = ("2020-01-01T00:00:00", "2021-01-01T00:00:00")


@dataclass(frozen=True)
class Case:
    """A document, and who allows ``publish rt/x`` by it."""

    row: str
    content: bytes
    allowing: str
    asked: dict = field(default_factory=dict)


def domains(text: str) -> bytes:
    return document(grant(rule("allow", X, domains=text)))


CASES = [
    Case("1", document(grant(ALLOW_X, subject="CN=/talker/below,OU=4f")), C),
    Case("1", document(grant(ALLOW_X, subject="CN=/talker, OU=4f")), f"{C11} {F} {O}"),
    Case("1", document(grant(ALLOW_X, subject="OU=4f,CN=/talker")), f"{C} {F211} {O}"),
    Case("1", document(grant(ALLOW_X, subject="CN = /talker,OU= 4f")), f"{C11} {F211} {O}"),
    Case("1", document(grant(ALLOW_X, subject='CN="/talker",OU=4f')), F211),
    Case("2", document(grant(validity=PAST), grant(ALLOW_X)), f"{F} {O}"),
    Case("3", document(grant(rule("allow", criteria("publish", "rt/other")), default="ALLOW")), f"{C} {O}"),
    Case(
        "4",
        document(
            grant(rule("allow", criteria("publish", "rt/x", partitions=("a",)),
                       criteria("publish", "rt/y", partitions=("b",))))
        ),
        F,
        {"partitions": ["b"]},
    ),
    Case(
        "5",
        document(
            grant(rule("allow", criteria("publish", "rt/x", partitions=("a",))),
                  rule("allow", criteria("publish", "rt/x", partitions=("b",))))
        ),
        f"{C} {O}",
        {"partitions": ["b"]},
    ),
    Case(
        "6",
        document(grant(rule("deny", X), rule("allow", criteria("publish", "*", partitions=("*",))))),
        "",
    ),
    Case(
        "6",
        document(
            grant(rule("allow", criteria("subscribe", "rt/x")), rule("deny", X),
                  rule("allow", criteria("publish", "*", partitions=("*",))))
        ),
        C,
        {"partitions": ["a"]},
    ),
    Case(
        "7",
        document(
            grant(rule("allow", criteria("subscribe", "rt/x")),
                  rule("deny", criteria("publish", "rt/x", partitions=("a",))),
                  rule("allow", criteria("publish", "rt/x", partitions=("*",))))
        ),
        f"{C} {O}",
        {"partitions": ["b"]},
    ),
    Case("9", document(grant(rule("deny", criteria("subscribe", "rt/x")), ALLOW_X)), f"{C11} {F} {O}"),
    Case(
        "9",
        document(grant(rule("deny", X), rule("allow", criteria("publish", "*", partitions=("*",))))),
        "",
        {"partitions": ["a"]},
    ),
    Case("9", document(grant(ALLOW_X, rule("deny", criteria("subscribe", "rt/x")))), f"{C} {F} {O}"),
    Case("10", domains("<id>1</id>"), F),
    Case("11", domains("<id>0</id><id>231</id>"), f"{F} {O}"),
    Case("11", b"\xef\xbb\xbf" + document(grant(ALLOW_X)), f"{F} {O}"),
    Case("11", document(grant(ALLOW_X, rule("allow", criteria("publish", " ")))), O),
    Case("12", domains("<id_range><min>0</min></id_range>"), f"{C} {F} {O}"),
    Case("12", domains("<id_range><min>0</min></id_range>"), f"{F} {O}", {"domain": 7}),
    Case("13", domains("<id_range><max>3</max></id_range>"), f"{F} {O}"),
    Case("14", document(grant(ALLOW_X, validity=("2020-01-01T00:00:00Z", "2026-11-21T00:30:00+02:00"))), F),
    Case("15", document(grant(ALLOW_X, validity=("2020-01-01T00:00:00", "2300-01-01T00:00:00"))), f"{F} {O}"),
    Case("16", document(grant(rule("allow", criteria("publish", " rt/x ")))), C),
    Case("17", document(grant(rule("allow", criteria("publish", r"rt/\x")))), O),
    Case("17", document(grant(rule("allow", criteria("publish", "rt/[^y]")))), f"{F} {O}"),
    Case("19", document(grant(rule("deny", criteria("publish", "rt/y")), default="ALLOW")), f"{C} {O}"),
    Case("16", document(grant(rule("allow", X, criteria("publish", "rt/y", partitions=(" ",))))), f"{C} {F} {O}"),
    Case("16", document(grant(rule("allow", criteria("publish", "rt/x", partitions=(" ",))))), f"{C} {F}"),
    Case("data tags", document(grant(rule("deny", criteria("publish", "rt/x", tags="t")), ALLOW_X)), O),
]  # fmt: skip


def allows(variation, case: Case) -> bool:
    asked = {"subject_name": SUBJECT, "now": NOW, "domain": 0, "action": "publish", "topic": "rt/x", **case.asked}
    return decide(read(case.content), **asked, variation=variation).allowed


@pytest.mark.parametrize("case", CASES, ids=[f"{case.row} {number}" for number, case in enumerate(CASES)])
def test_row(case: Case) -> None:
    found = " ".join(sorted(name for name, variation in VARIATIONS.items() if allows(variation, case)))
    assert found == " ".join(sorted(case.allowing.split()))


ALSO = {"13": "11", "19": "3"}
"""Rows whose documents one vendor decides by another row."""


@pytest.mark.parametrize(
    "variation", [each for each in VARIATIONS.values() if each is not OMG], ids=lambda variation: variation.name
)
@pytest.mark.parametrize("case", CASES, ids=[f"{case.row} {number}" for number, case in enumerate(CASES)])
def test_a_difference_is_explained_by_its_row(variation, case: Case) -> None:
    found = explain(lambda asked: allows(asked, case), variation)
    if allows(variation, case) == allows(OMG, case):
        assert found == ()
    else:
        assert {ALSO.get(case.row), case.row} & {deviation.row for deviation in found}


def test_every_deviation_is_tested_and_documented() -> None:
    rows = {deviation.row for variation in VARIATIONS.values() for deviation in variation.deviations}
    of_governance = {"20"}  # test_access.py
    of_identities = {"21", "22", "23"}  # transports/test_enclave_model.py
    assert rows <= {case.row for case in CASES} | of_governance | of_identities
    text = (Path(__file__).parents[4] / "docs" / "vendors.md").read_text()
    documented = set(re.findall(r"^\| ([\w ]+?) \|", text, re.MULTILINE))
    assert rows <= documented
