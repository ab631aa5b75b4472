# SPDX-License-Identifier: Apache-2.0
"""The table of injected faults against real vendors: who decides otherwise, as the table says."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from keymint_ros2_dds.vendors.cyclone_access_control import AccessControl

from keymint import cli
from tests.effort import FULL
from tests.keymint.examine.fault import Fault
from tests.keymint.examine.fault_keystores import ADOPTED, NAMES, PLAIN, SUBJECTS, Bench, Keystore
from tests.keymint.examine.faults_of_permissions import FAULTS as OF_PERMISSIONS
from tests.keymint.examine.faults_of_signers import FAULTS as OF_SIGNERS

ACCESS = {1, 2, 3, 4, 5, 6, 8, 10, 13, 18}
"""Classes that access control alone decides; of others, it decides some faults."""
SAMPLE = 6
DOMAINS = (0, 1, 5)


def judged_by_access_control(fault: Fault) -> bool:
    """Tell whether permissions, governance and the name of a certificate are all that a fault changes."""
    if fault.kind == 7:
        return " grant " in fault.name
    if fault.kind == 9:
        return "certificate" not in fault.name
    if fault.kind == 12:
        return fault.name.startswith(("reading", "writing", "names", "one name", "services", "all but ROS"))
    if fault.kind == 11:
        return "documents" in fault.name or " by the identity authority" in fault.name
    return fault.kind in ACCESS


JUDGED = [fault for fault in (*OF_PERMISSIONS, *OF_SIGNERS) if judged_by_access_control(fault)]


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


def cyclone_rights(keystore: Keystore, subjects: tuple[str, ...], scratch: Path) -> Rights:
    """Ask Cyclone DDS what the holder of each certificate may do with each document that is in the keystore."""
    found: Rights = {}
    for holder in subjects:
        for donor in subjects:
            folder = scratch / f"{holder}-{donor}".replace("/", ".")
            shutil.copytree(keystore.enclave(holder), folder, ignore=_folders, dirs_exist_ok=True)
            shutil.copyfile(keystore.enclave(donor) / "permissions.p7s", folder / "permissions.p7s")
            found[holder, donor] = set()
            for domain in DOMAINS:
                with AccessControl.of_enclave(folder, domain) as access:
                    if access.joins():
                        found[holder, donor] |= {(domain, "join", "")}
                        found[holder, donor] |= {
                            (domain, action, name)
                            for action in ("publish", "subscribe")
                            for name in NAMES
                            if access.allows(action, name)
                        }
            shutil.rmtree(folder)
    return found


def _folders(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if (Path(folder) / name).is_dir()]


def violated(before: Rights, after: Rights) -> list[tuple[str, str]]:
    """Return where a holder may do other than before with its own document, or with another more than its own rights."""
    return [
        (holder, donor)
        for (holder, donor), rights in after.items()
        if (rights != before[holder, holder] if holder == donor else rights - before[holder, holder])
    ]


@pytest.fixture(scope="module")
def sound(real_bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Rights]:
    """Return what Cyclone DDS decides on workspaces without faults."""
    known: dict[str, Rights] = {}

    def rights(kind: str) -> Rights:
        if kind not in known:
            subjects = {"adopted": ADOPTED, "plain names": PLAIN}.get(kind, SUBJECTS)
            known[kind] = cyclone_rights(real_bench.copy(kind), subjects, tmp_path_factory.mktemp("sound"))
        return known[kind]

    return rights


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@pytest.mark.parametrize("fault", sample(JUDGED), ids=lambda fault: fault.id)
def test_cyclone_decides_as_the_table_says(
    real_bench: Bench, sound: Callable[[str], Rights], tmp_path: Path, fault: Fault
) -> None:
    before = sound(fault.workspace)
    assert violated(before, before) == []
    keystore = real_bench.copy(fault.workspace)
    from tests.keymint.examine.fault_keystores import meaning

    meant = meaning(keystore, fault.subjects)
    fault.apply(keystore)
    decides = meaning(keystore, fault.subjects) != meant if fault.decides is None else fault.decides
    expected = decides and (fault.vendors == "all" or "cyclonedds" in fault.vendors)
    found = violated(before, cyclone_rights(keystore, fault.subjects, tmp_path))
    assert bool(found) == expected, (fault.vendors, found)
