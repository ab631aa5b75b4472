# SPDX-License-Identifier: Apache-2.0
"""The comparer finds every kind of difference, and what is recorded twice is equal."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.behaviour import compare, workspaces
from tests.behaviour.checkout import Checkout
from tests.behaviour.record import Steps

CHECKOUT = Path(__file__).resolve().parents[2]
STEP: dict[str, Any] = {
    "argv": ["check", "--json"], "label": "", "days": 0, "exit": 0, "err": ["a warning"], "codes": ["error stale"],
    "json": {"result": {"enclaves": ["/talker"], "none": []}},
    "files": {"ws/a.xml": {"mode": "-rw-------", "content": "<dds/>"}, "ws/gone": None},
}  # fmt: skip
Change = Callable[[dict[str, Any]], object]


def _differences(tmp_path: Path, old: list[Any], new: list[Any]) -> list[compare.Difference]:
    for name, steps in (("old", old), ("new", new)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "case.json").write_text(json.dumps(steps))
    return compare.differences(tmp_path / "old", tmp_path / "new")


CHANGES: dict[str, tuple[str, Change]] = {
    "exit code": ("exit code", lambda step: step.update(exit=3)),
    "code": ("code", lambda step: step.update(codes=["warning stale"])),
    "code gone": ("code", lambda step: step.update(codes=[])),
    "message": ("output", lambda step: step.update(err=["another warning"])),
    "member removed": ("member removed", lambda step: step["json"]["result"].pop("none")),
    "member added": ("member added", lambda step: step["json"].update(more={})),
    "member": ("member", lambda step: step["json"]["result"].update(enclaves=["/listener"])),
    "document": ("document", lambda step: step["files"]["ws/a.xml"].update(content="<dds />")),
    "mode": ("mode", lambda step: step["files"]["ws/a.xml"].update(mode="-rw-r--r--")),
    "file not written": ("file", lambda step: step["files"].pop("ws/a.xml")),
    "file not removed": ("file", lambda step: step["files"].pop("ws/gone")),
    "file removed": ("file", lambda step: step["files"].update({"ws/a.xml": None})),
    "command": ("step", lambda step: step.update(argv=["prove"])),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_found(tmp_path: Path, name: str) -> None:
    kind, change = CHANGES[name]
    changed = copy.deepcopy(STEP)
    change(changed)
    found = _differences(tmp_path, [STEP, STEP], [STEP, changed])
    assert [each.kind for each in found] == [kind]
    assert found[0].where.startswith("case #1")
    assert len(list(compare.report(found))) >= 3


def test_cases_and_steps_that_are_missing_are_found(tmp_path: Path) -> None:
    assert [each.kind for each in _differences(tmp_path, [STEP], [STEP, STEP])] == ["step"]
    (tmp_path / "new/more.json").write_text("[]")
    assert [each.kind for each in compare.differences(tmp_path / "old", tmp_path / "new")] == ["case", "step"]


def test_without_records_there_is_no_answer(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no records"):
        compare.differences(tmp_path, tmp_path)


def _sample(s: Steps) -> None:
    workspaces.provision(s)
    s.run("revoke", "talker", "--reason", "superseded", "-w", "ws")
    s.both("issued", "-w", "ws")
    s.run("authority", "show", "--json", "-w", "ws")
    s.run("bundle", "talker", "-o", "talker.bundle", "-w", "ws")
    s.remove("ws/install/enclaves/planner/cert.pem")
    s.both("check", "-w", "ws")


def test_a_sample_that_is_recorded_twice_is_equal(tmp_path: Path) -> None:
    """Keys, serial numbers and signatures differ, and nothing else; what is signed is recorded to the byte."""
    checkout = Checkout(CHECKOUT, tmp_path)
    records = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        steps = Steps(checkout, tmp_path / name)
        _sample(steps)
        records.append(steps.steps)
    checkout.close()
    assert _differences(tmp_path, *records) == []
    assert [step["exit"] for step in records[0]] == [0, 0, 0, 0, 0, 0, 3, 3]
    signed = records[0][0]["files"]["ws/install/enclaves/talker/permissions.p7s"]["content"]
    assert "<topic>rt/chatter</topic>" in signed["signed"]
    assert signed["signers"] == ["CN=permissions_ca"]
    assert records[0][-1]["codes"]
    assert records[0][-2]["err"]
