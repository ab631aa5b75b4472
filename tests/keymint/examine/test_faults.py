# SPDX-License-Identifier: Apache-2.0
"""Fault injection: no fault that changes what a vendor decides is missed by ``check`` or by ``prove``.

``pytest -k class07`` runs one class. Without ``KEYMINT_FULL=1`` a few faults of each class are tried.
"""

from __future__ import annotations

import shutil
from collections import Counter, defaultdict
from datetime import UTC, datetime

import pytest

from keymint import cli
from tests.conftest import NOW
from tests.effort import FULL

from .fault import CLASSES, Fault
from .fault_keystores import Bench, meaning
from .faults_of_bundles import FAULTS as OF_BUNDLES
from .faults_of_keystores import FAULTS as OF_KEYSTORES
from .faults_of_permissions import FAULTS as OF_PERMISSIONS
from .faults_of_signers import FAULTS as OF_SIGNERS
from .faults_of_zenoh import FAULTS as OF_ZENOH

TABLE: tuple[Fault, ...] = (*OF_PERMISSIONS, *OF_SIGNERS, *OF_KEYSTORES, *OF_BUNDLES, *OF_ZENOH)
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


@pytest.mark.parametrize("fault", sample(), ids=lambda fault: fault.id)
def test_no_fault_is_missed(keymint, bench: Bench, fault: Fault) -> None:
    """With the record of written files, and again without it, where only what the files say can tell."""
    keystore = bench.copy(fault.workspace)
    before = meaning(keystore, fault.subjects) if fault.decides is None else {}
    fault.apply(keystore)
    decides = meaning(keystore, fault.subjects) != before if fault.decides is None else fault.decides
    check, prove = fault.must(decides=decides)
    said = {}
    for memory in ("recorded", "without record"):
        if memory == "without record":
            shutil.rmtree(keystore.ws / ".keymint")
        for verb, found in (("check", check), ("prove", prove)):
            outcome = keymint(verb, "--json", "-w", keystore.ws)
            assert outcome.code in {0, 3}, (verb, memory, outcome.out, outcome.err)
            expected = found if memory == "recorded" or fault.recordless else None
            if expected is not None and outcome.code != (3 if expected else 0):
                said[f"{verb}, {memory}"] = f"{'missed' if expected else 'refuted'}: {outcome.codes()}"
    assert said == {}, f"{CLASSES[fault.kind]}; decides: {fault.vendors if decides else 'nobody'}"


@pytest.mark.parametrize("kind", sorted({fault.workspace for fault in TABLE}))
def test_without_a_fault_nothing_is_found(keymint, bench: Bench, kind: str) -> None:
    keystore = bench.copy(kind)
    for _ in range(2):
        for verb in ("check", "prove"):
            outcome = keymint(verb, "-w", keystore.ws)
            assert outcome.code == 0, (verb, outcome.out, outcome.err)
        shutil.rmtree(keystore.ws / ".keymint", ignore_errors=True)
