# SPDX-License-Identifier: Apache-2.0
"""The table of injected faults against real vendors: who decides otherwise, as the table says."""

from __future__ import annotations

import functools
import shutil
import subprocess
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from keymint_ros2_dds.vendors.participants import RefusedError, System

from keymint import cli
from tests.effort import FULL
from tests.keymint.examine.fault import Fault
from tests.keymint.examine.fault_keystores import (
    ADOPTED,
    CAMERA,
    NAMES,
    PLAIN,
    PLANNER,
    SUBJECTS,
    TALKER,
    Keystore,
    meaning,
    public,
)
from tests.keymint.examine.fault_table import TABLE
from tests.keymint.examine.fault_workspaces import Bench
from tests.signers import HAVE_OPENSSL

from .conftest import on_each_fastdds
from .handmade import access_control

if TYPE_CHECKING:
    from keymint_ros2_dds.vendors.participants import Vendor

ACCESS = {1, 2, 3, 4, 5, 6, 8, 10, 13, 18}
"""Classes that access control alone decides; of others, it decides some faults."""
SAMPLE = 2
DOMAINS = (0, 1, 5)


def judged_by_access_control(fault: Fault) -> bool:
    """Tell whether permissions, governance and the name of a certificate are all that a fault changes."""
    if " by a policy" in fault.name:
        return False
    if fault.kind == 7:
        return " grant " in fault.name
    if fault.kind == 9:
        return "certificate" not in fault.name
    if fault.kind == 12:
        return fault.name.startswith(("reading", "writing", "names", "one name", "services", "all but ROS"))
    if fault.kind == 11:
        return "documents" in fault.name or " by the identity authority" in fault.name
    return fault.kind in ACCESS


JUDGED = [fault for fault in TABLE if judged_by_access_control(fault)]


def sample(faults: list[Fault]) -> list[Fault]:
    """Return all faults, or a few of each class."""
    if FULL:
        return faults
    kinds = sorted({fault.kind for fault in faults})
    classes = [[fault for fault in faults if fault.kind == kind] for kind in kinds]
    return [found[at * len(found) // SAMPLE] for found in classes for at in range(SAMPLE)]


@pytest.fixture(scope="module")
def real_bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """Workspaces at the clock of the machine, which vendors read."""

    def run(*words: object) -> int:
        with pytest.MonkeyPatch.context() as patch:
            patch.delenv("SOURCE_DATE_EPOCH", raising=False)
            patch.delenv("ROS_DISTRO", raising=False)
            return cli.main([str(word) for word in words])

    folder = tmp_path_factory.mktemp("real-faults")
    yield Bench(folder, run, datetime.now(UTC).replace(microsecond=0))
    shutil.rmtree(folder)


Rights = dict[tuple[str, str], set[tuple[int, str, str]]]
"""What each holder of a certificate may do with each document: domain, direction and topic."""


def cyclone_rights(keystore: Keystore, subjects: tuple[str, ...]) -> Rights:
    """Ask Cyclone DDS what the holder of each certificate may do with each document that is in the keystore."""
    found: Rights = {}
    for holder in subjects:
        own = [
            (keystore.enclave(holder) / name).read_bytes()
            for name in ("cert.pem", "permissions_ca.cert.pem", "governance.p7s")
        ]
        for donor in subjects:
            presented = (keystore.enclave(donor) / "permissions.p7s").read_bytes()
            found[holder, donor] = {each for domain in DOMAINS for each in _asked(*own, presented, domain)}
    return found


@functools.cache
def _asked(
    certificate: bytes, permissions_ca: bytes, governance: bytes, permissions: bytes, domain: int
) -> frozenset[tuple[int, str, str]]:
    with access_control(
        certificate=certificate, permissions_ca=permissions_ca, governance=governance, permissions=permissions,
        domain=domain,
    ) as access:  # fmt: skip
        if not access.joins():
            return frozenset()
        asked = [(action, name) for action in ("publish", "subscribe") for name in NAMES]
        allowed = {(domain, action, name) for action, name in asked if access.allows(action, name)}
        return frozenset({(domain, "join", ""), *allowed})


def violated(before: Rights, after: Rights) -> list[tuple[str, str]]:
    """Return where a holder may do other than before with its own document, or more with that of another."""
    return [
        (holder, donor)
        for (holder, donor), rights in after.items()
        if (rights != before[holder, holder] if holder == donor else rights - before[holder, holder])
    ]


@pytest.fixture(scope="module")
def sound(real_bench: Bench) -> Callable[[str], Rights]:
    """Return what Cyclone DDS decides on workspaces without faults."""
    known: dict[str, Rights] = {}

    def rights(kind: str) -> Rights:
        if kind not in known:
            subjects = {"adopted": ADOPTED, "plain names": PLAIN}.get(kind, SUBJECTS)
            known[kind] = cyclone_rights(real_bench.copy(kind), subjects)
        return known[kind]

    return rights


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@pytest.mark.parametrize("fault", sample(JUDGED), ids=lambda fault: fault.id)
def test_cyclone_decides_as_the_table_says(real_bench: Bench, sound: Callable[[str], Rights], fault: Fault) -> None:
    before = sound(fault.workspace)
    assert violated(before, before) == []
    keystore = real_bench.copy(fault.workspace)
    meant = meaning(keystore, fault.subjects)
    fault.apply(keystore)
    decides = meaning(keystore, fault.subjects) != meant if fault.decides is None else fault.decides
    expected = decides and (fault.vendors == "all" or "cyclonedds" in fault.vendors)
    found = violated(before, cyclone_rights(keystore, fault.subjects))
    assert bool(found) == expected, (fault.vendors, found)


# -- certificates and lists, by OpenSSL, which both vendors call with the files of the enclave -------------------------

BY_CERTIFICATE = ("has key of", "has certificate of", "no key", "certificate of generation")


def judged_by_openssl(fault: Fault) -> bool:
    """Tell whether a fault changes whom an enclave authenticates now."""
    if fault.kind in {14, 15, 16}:
        return True
    if fault.kind == 7:
        return "certificate" in fault.name and fault.vendors == "all"
    if fault.kind == 11:
        return "certificate by a namesake" in fault.name or "namesake for identities" in fault.name
    if fault.kind == 20:
        return any(each in fault.name for each in BY_CERTIFICATE) or fault.name.endswith("a key of nobody")
    return fault.kind == 9 and any(each in fault.name for each in BY_CERTIFICATE)


AUTHENTICATED = [fault for fault in TABLE if judged_by_openssl(fault)]
Admitted = dict[tuple[str, str], bool]
"""Whether an enclave accepts who has a certificate, by the enclave and by what the certificate is."""


def admitted(keystore: Keystore) -> Admitted:
    """Ask OpenSSL which enclave accepts which: those installed, and the certificates of earlier days."""
    installed = [each for each in SUBJECTS if (keystore.enclave(each) / "identity_ca.cert.pem").exists()]
    holders = {f"{each} now": keystore.enclave(each) for each in installed}
    for number in range(5):
        for subject in (CAMERA, PLANNER, TALKER):
            folder = keystore.stage(number, subject)
            if (folder / "cert.pem").exists():
                holders[f"{subject} on day {number}"] = folder
    return {
        (verifier, holder): _has_key(folder) and _verifies(keystore.enclave(verifier), folder / "cert.pem")
        for verifier in installed
        for holder, folder in holders.items()
    }


def _has_key(folder: Path) -> bool:
    if not (folder / "key.pem").exists():
        return False
    key = load_pem_private_key((folder / "key.pem").read_bytes(), None)
    certificate = x509.load_pem_x509_certificate((folder / "cert.pem").read_bytes())
    return public(key.public_key()) == public(certificate.public_key())


def _verifies(enclave: Path, certificate: Path) -> bool:
    """Tell whether an enclave accepts a certificate; vendors read the first list alone (``test_keystore_life``)."""
    command = ["openssl", "verify", "-no-CApath", "-no-CAstore", "-CAfile", str(enclave / "identity_ca.cert.pem")]
    with NamedTemporaryFile() as first:
        if (enclave / "crl.pem").exists():
            content, end = (enclave / "crl.pem").read_bytes(), b"-----END X509 CRL-----\n"
            Path(first.name).write_bytes(content.partition(end)[0] + end)
            command += ["-crl_check", "-CRLfile", first.name]
        return subprocess.run([*command, str(certificate)], capture_output=True, check=False).returncode == 0


@pytest.fixture(scope="module")
def sound_admission(real_bench: Bench) -> Callable[[str], Admitted]:
    """Return who accepts whom in workspaces without faults."""
    known: dict[str, Admitted] = {}

    def found(kind: str) -> Admitted:
        if kind not in known:
            known[kind] = admitted(real_bench.copy(kind))
        return known[kind]

    return found


@pytest.mark.skipif(not HAVE_OPENSSL, reason="openssl is not installed: apt-get install openssl")
@pytest.mark.parametrize("fault", sample(AUTHENTICATED), ids=lambda fault: fault.id)
def test_openssl_authenticates_as_the_table_says(
    real_bench: Bench, sound_admission: Callable[[str], Admitted], fault: Fault
) -> None:
    before = sound_admission(fault.workspace)
    keystore = real_bench.copy(fault.workspace)
    fault.apply(keystore)
    after = admitted(keystore)
    assert before.keys() == after.keys()
    changed = {pair: allowed for pair, allowed in after.items() if allowed != before[pair]}
    assert bool(changed) == fault.decides


# -- Fast DDS, by participants of its own ------------------------------------------------------------------------------

OWN = [
    fault
    for fault in JUDGED
    if fault.kind in {4, 5, 6, 7, 10, 13} and fault.workspace == "dds" and fault.decides is not False
    and any(fault.name.startswith(f"{subject} ") for subject in SUBJECTS)
]  # fmt: skip
"""Faults that change what an enclave may do with its own documents, which begin with its name."""


def _fastdds_rights(vendor: Vendor, folder: Path) -> set[tuple[str, str]]:
    with System(vendor) as system:
        try:
            participant = system.open(folder)
        except RefusedError:
            return set()
        asked = [(action, name) for action in ("publish", "subscribe") for name in NAMES]
        answers = participant.allow([(action, name, ()) for action, name in asked])
        return {each for each, allowed in zip(asked, answers, strict=True) if allowed}


@on_each_fastdds
@pytest.mark.parametrize("fault", sample(OWN), ids=lambda fault: fault.id)
def test_fastdds_decides_as_the_table_says(real_bench: Bench, vendor: Vendor, fault: Fault) -> None:
    keystore = real_bench.copy(fault.workspace)
    subject = max((each for each in SUBJECTS if fault.name.startswith(f"{each} ")), key=len)
    sound, meant = _fastdds_rights(vendor, keystore.enclave(subject)), meaning(keystore, fault.subjects)
    fault.apply(keystore)
    decides = meaning(keystore, fault.subjects) != meant if fault.decides is None else True
    expected = decides and (fault.vendors == "all" or "fastdds" in fault.vendors.split(" if ")[0])
    if "a deny of what is" in fault.name or " if " in fault.vendors:
        return  # only Cyclone DDS; only later
    assert (_fastdds_rights(vendor, keystore.enclave(subject)) != sound) == expected
