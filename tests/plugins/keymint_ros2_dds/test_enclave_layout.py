# SPDX-License-Identifier: Apache-2.0
"""The files of an enclave."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.enclave_layout import CRL, FILES, files, reads_revocations
from keymint_ros2_dds.lowering.mapping import DISTROS


def test_distributions_read_revocation_lists_from_humble_on() -> None:
    first = DISTROS.index("humble")
    assert [reads_revocations(each) for each in DISTROS] == [at >= first for at in range(len(DISTROS))]


@pytest.mark.parametrize("layout", FILES)
def test_every_layout_may_have_a_list(layout: str) -> None:
    assert CRL in files(layout)
    assert set(FILES[layout]) <= files(layout)
