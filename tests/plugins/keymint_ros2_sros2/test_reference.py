# SPDX-License-Identifier: Apache-2.0
"""SROS2's own policies, and the permissions documents that SROS2 wrote from them."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_sros2 import policy_type

from comarmor.data import locate
from keymint.api import ImportedSubject, ImportRequest

from .test_translate import is_same

POLICIES = ("add_two_ints", "talker_listener")


@pytest.mark.parametrize("distro", ["foxy", "iron"])
@pytest.mark.parametrize("name", POLICIES)
def test_they_mean_what_sros2_wrote(reference: Path, name: str, distro: str) -> None:
    folder = reference / "sros2"
    assert {path.name for path in folder.glob("*.policy.xml")} == {f"{each}.policy.xml" for each in POLICIES}
    library = locate("keymint_ros", "templates") / "comarmor.d" / distro
    path = folder / f"{name}.policy.xml"
    found = policy_type.translated(ImportRequest(path, "new.xml", library, implicit=False))
    expected = (folder / f"expected/{name}.permissions.xml").read_bytes()
    assert len(found.subjects) == 2
    for subject in found.subjects:
        assert is_same(subject)
        assert is_same(ImportedSubject(subject.rules, expected, subject.subject_name))
    assert b"xi:include" in found.document
