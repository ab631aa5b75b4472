# SPDX-License-Identifier: Apache-2.0
"""Fault injection: no fault that changes what a vendor decides is missed by ``check`` or by ``prove``.

``pytest -k class07`` runs one class. Without ``KEYMINT_FULL=1`` a few faults of each class are tried.
"""

from __future__ import annotations

import shutil
from collections import Counter, defaultdict
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from keymint import cli
from tests.conftest import NOW
from tests.effort import FULL

from .fault import CLASSES, Fault
from .fault_keystores import meaning
from .fault_table import TABLE
from .fault_workspaces import Bench

SAMPLE = 2
"""How many faults of each class are tried by default."""


def sample(faults: tuple[Fault, ...] = TABLE) -> list[Fault]:
    """Return the faults to try: all, or a few of each class, evenly spread."""
    classes: defaultdict[int, list[Fault]] = defaultdict(list)
    for fault in faults:
        classes[fault.kind].append(fault)
    if FULL:
        return list(faults)
    return [found[at * len(found) // SAMPLE] for found in classes.values() for at in range(SAMPLE)]


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Workspaces of every kind, at the clock of the tests."""

    def run(*words: object) -> int:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("SOURCE_DATE_EPOCH", str(NOW))
            return cli.main([str(word) for word in words])

    return Bench(tmp_path_factory.mktemp("faults"), run, datetime.fromtimestamp(NOW, UTC))


def test_each_class_has_fifty_faults() -> None:
    counted = Counter(fault.kind for fault in TABLE)
    assert {kind: counted[kind] for kind in CLASSES if counted[kind] < 50} == {}
    assert len({fault.id for fault in TABLE}) == len(TABLE)


Findings = frozenset[tuple[str, str, str, str]]
"""Errors and warnings: severity, code, file and message."""
MEMORIES = ("recorded", "without record")


def findings(keymint, ws: Path) -> Iterator[tuple[str, str, Findings]]:
    """Yield what each verb finds, first with the record of written files, then without it."""
    for memory in MEMORIES:
        if memory != "recorded":
            shutil.rmtree(ws / ".keymint")
        for verb in ("check", "prove"):
            outcome = keymint(verb, "--json", "-w", ws)
            assert outcome.code in {0, 3}, (verb, memory, outcome.out, outcome.err)
            found = frozenset(
                (each["severity"], each["code"], each.get("file") or "", each["message"])
                for each in outcome.document["diagnostics"]
                if each["severity"] != "note"
            )
            assert bool(found) >= (outcome.code == 3), "it says what it found"
            yield verb, memory, found if outcome.code == 3 else frozenset()


@pytest.fixture(scope="session")
def sound() -> dict[str, dict[tuple[str, str], Findings]]:
    """What the verbs find without a fault, by kind of workspace."""
    return {}


@pytest.mark.parametrize("fault", sample(), ids=lambda fault: fault.id)
def test_no_fault_is_missed(keymint, bench: Bench, sound: dict, fault: Fault) -> None:
    """With the record of written files, and again without it, where only what the files say can tell."""
    keystore = bench.copy(fault.workspace)
    if fault.workspace not in sound:
        found = findings(keymint, keystore.ws)
        sound[fault.workspace] = {(verb, memory): each for verb, memory, each in found}
        keystore = bench.copy(fault.workspace)
    before = meaning(keystore, fault.subjects) if fault.decides is None else {}
    fault.apply(keystore)
    decides = meaning(keystore, fault.subjects) != before if fault.decides is None else fault.decides
    check, prove = fault.must(decides=decides)
    wrong = {}
    for verb, memory, found in findings(keymint, keystore.ws):
        expected = check if verb == "check" else prove
        new = found - sound[fault.workspace][verb, memory]
        if expected is not None and bool(new) != expected:
            wrong[f"{verb}, {memory}"] = f"refuted: {sorted(new)}" if new else "missed"
    assert wrong == {}, f"{CLASSES[fault.kind]}; decides: {fault.vendors if decides else 'nobody'}"


ONE_AUTHORITY = "adopted"
"""The workspace of which ``check`` always says what it lacks."""


@pytest.mark.parametrize("kind", sorted({fault.workspace for fault in TABLE} - {ONE_AUTHORITY}))
def test_without_a_fault_nothing_is_found(keymint, bench: Bench, kind: str) -> None:
    keystore = bench.copy(kind)
    assert {(*said, found) for *said, found in findings(keymint, keystore.ws) if found} == set()


def test_class18_one_authority_is_an_exception_of_the_proof(keymint, bench: Bench) -> None:
    """Identities can sign documents there: the proof says so, and what ends it."""
    keystore = bench.copy(ONE_AUTHORITY)
    outcome = keymint("prove", "-w", keystore.ws)
    assert outcome.code == 0
    assert "harden" in outcome.out + outcome.err
    assert keymint("prove", "--strict", "-w", keystore.ws).code == 3


def test_class09_documents_of_a_wider_policy_are_remembered(keymint, bench: Bench) -> None:
    """They were signed, and fit certificates in force: whoever has one may present it."""
    keystore = bench.copy("narrowed")
    assert keymint("prove", "-w", keystore.ws).code == 0
    assert keymint("prove", "--strict", "-w", keystore.ws).code == 3
