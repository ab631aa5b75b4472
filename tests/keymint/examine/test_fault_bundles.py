# SPDX-License-Identifier: Apache-2.0
"""Fault injection, class 21: no bundle of a keystore with a fault leaves, and no robot takes a forged one."""

from __future__ import annotations

import hashlib

import pytest
from cryptography import x509

from comarmor.errors import Origin
from keymint.robots import bundle
from tests.conftest import snapshot
from tests.effort import FULL

from .fault_keystores import SUBJECTS, public
from .fault_workspaces import Bench
from .faults_of_bundles import FORGED, Forged, outgoing
from .test_faults import bench  # noqa: F401 - a fixture

OUTGOING = list(outgoing())
INCOMING = [(forged, subject) for forged in FORGED for subject in SUBJECTS]


@pytest.mark.parametrize(
    ("name", "subject", "apply"),
    OUTGOING if FULL else OUTGOING[::17],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_class21_no_bundle_of_a_fault_leaves(keymint, bench: Bench, name: str, subject: str, apply) -> None:  # noqa: F811
    keystore = bench.copy("dds")
    apply(keystore)
    file = keystore.ws.parent / "out.bundle"
    outcome = keymint("bundle", subject, "-w", keystore.ws, "-o", file, "--json")
    if outcome.code == 0 and name.endswith("a list that is over"):  # no authority has a list in force: it stays behind
        assert "crl.pem" not in bundle.read(file.read_bytes(), Origin("test")).files
        return
    assert outcome.code in {1, 3}, (name, outcome.out)
    assert outcome.codes()
    assert not file.exists()


@pytest.mark.parametrize(
    ("forged", "subject"), INCOMING if FULL else INCOMING[::11], ids=lambda each: getattr(each, "name", str(each))
)
def test_class21_no_robot_takes_a_forged_bundle(keymint, bench: Bench, forged: Forged, subject: str) -> None:  # noqa: F811
    keystore = bench.copy("dds")
    robot, file = keystore.ws.parent / "robot", keystore.ws.parent / "x.bundle"
    certificate = x509.load_pem_x509_certificate((keystore.ws / "public/identity_ca.cert.pem").read_bytes())
    trusted = ("--authority-fingerprint", hashlib.sha256(public(certificate.public_key())).hexdigest())
    assert keymint("bundle", subject, "-w", keystore.ws, "-o", file).code == 0
    genuine = file.read_bytes()
    assert keymint("accept", file, "--folder", robot, "--new", *trusted).code == 0
    assert keymint("accept", file, "--folder", robot).code == 0, "the same again is taken"
    before = snapshot(robot)
    file.write_bytes(forged.content(keystore, subject, genuine))
    outcome = keymint("accept", file, "--folder", robot, "--json")
    assert outcome.code in {1, 3}, (forged.name, outcome.out)
    assert outcome.codes()
    after = snapshot(robot)
    assert {name for name in before if before[name][2] != after.get(name, (0, 0, b""))[2]} == set()


def test_class21_has_fifty_faults() -> None:
    assert len(OUTGOING) >= 50
    assert len(INCOMING) >= 50
