# SPDX-License-Identifier: Apache-2.0
"""The files of an enclave."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.enclave_layout import CRL, LAYOUTS, enclave_files, files, has_one_authority, reads_revocations
from keymint_ros2_dds.lowering.name_mapping import DISTROS


def test_distributions_read_revocation_lists_from_humble_on() -> None:
    first = [*DISTROS].index("humble")
    assert [reads_revocations(each) for each in DISTROS] == [at >= first for at in range(len(DISTROS))]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("distro", DISTROS)
def test_every_layout_may_have_a_list(layout: str, distro: str) -> None:
    assert CRL in files(layout)
    assert set(enclave_files(layout, distro)) <= files(layout)


def test_no_layout_has_one_file_in_place_of_another() -> None:
    flat = {distro: {name for name in enclave_files("flat", distro) if "_ca" in name} for distro in DISTROS}
    assert [distro for distro in DISTROS if flat[distro]] == ["crystal", "dashing", "eloquent"]
    assert all(has_one_authority("flat", distro) == (not flat[distro]) for distro in DISTROS)
    assert enclave_files("round", "jazzy") == ()
