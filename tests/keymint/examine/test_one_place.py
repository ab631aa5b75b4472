# SPDX-License-Identifier: Apache-2.0
"""A rule about installed files stands in one place: no two modules raise its code, but for what this file says."""

from __future__ import annotations

import importlib
import re

from keymint import examine
from tests.conftest import CHECKOUT
from tests.test_golden_codes import all_codes

JUDGES = (
    "keymint/examine/",
    "keymint/pki/examine.py",
    "keymint/adoption/keystore_files.py",
    "plugins/keymint_ros2_dds/examine/",
    "plugins/keymint_ros2_zenoh/examine/",
)
"""The modules that judge the bytes of installed files."""
VIEW = "plugins/keymint_ros2_dds/examine/adopted_enclave.py"
"""Its table says what the answer of a rule means for a keystore that is taken over; it raises ``adopt-*`` only."""
TWICE = {
    "dates of one file, along the path of a certificate, and as each model of a proof reads them": {
        "certificate-expired", "certificate-not-yet-valid", "grant-expired", "grant-never-valid",
        "grant-not-yet-valid", "revocation-list-expired", "revocation-list-not-yet-valid",
    },
    "the same defect in sources, in what is about to be made, or in a file that the user names": {
        "domain-uncovered", "file-changed", "file-kind", "file-missing", "file-size",
        "zenoh-common-name", "zenoh-host-name", "zenoh-key-usage",
    },
    "the verb that would need it refuses": {
        "adopt-unsupported", "authority-missing", "bundle-dates", "rollover-incomplete",
    },
    "as imported, and as the profile specifies it": {"authority-drift"},
    "two transports": {"drift", "file-unexpected"},
    "one name, and one name among others": {"names-confused"},
    "check notes it, and who needs what is not there refuses": {"not-examined", "register-lost"},
    "a folder that is a part of a keystore, and one that is none": {"keystore-unknown"},
    "the audit report counts it among exposures": {"file-mode"},
    "a code of keymint adopt for two kinds of files": {"adopt-encoding", "adopt-revocations"},
}  # fmt: skip
"""Why a code of theirs is raised in two modules. This may only become less."""


def test_a_code_is_raised_in_one_place() -> None:
    raised = {
        code: {file for file in files if file != VIEW or code.startswith("adopt-")}
        for code, files in all_codes().items()
    }
    judged = {code: files for code, files in raised.items() if any(file.startswith(JUDGES) for file in files)}
    assert len(judged) > 100
    twice = {code: sorted(files) for code, files in judged.items() if len(files) > 1}
    known = set[str]().union(*TWICE.values())
    assert {code: files for code, files in twice.items() if code not in known} == {}
    assert known - twice.keys() == set(), "this is raised in one place now: take it from the list"


def test_the_room_names_all_that_judge() -> None:
    text = examine.__doc__ or ""
    for path in (CHECKOUT / "keymint/examine").glob("[!_]*.py"):
        assert f"``{path.stem}``" in text
    for module in re.findall(r"``(keymint(?:_\w+)?\.[\w.]+)``", text):
        importlib.import_module(module)
