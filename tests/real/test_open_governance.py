# SPDX-License-Identifier: Apache-2.0
"""Every topic that a governance opens is reported, on random documents and policies, each in three domains."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import pytest

from tests.effort import tries

from .conftest import on_each_fastdds
from .open_governance import Bench, compare

if TYPE_CHECKING:
    from pathlib import Path

    from keymint_ros2_dds.vendors.participants import Vendor

SEED = 2018


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


def test_claims_and_models_agree_with_brute_force(bench: Bench) -> None:
    counts, wrong = compare(bench, SEED, tries(100, 3_000), bench.modelled)
    assert wrong == []
    assert counts["model"] > tries(30_000, 1_400_000)
    assert min(counts["differing"], counts["claims proven"], counts["claims counterexample"]) > tries(100, 3_000)


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
def test_cyclone_dds_decides_as_brute_force_does(bench: Bench) -> None:
    counts, wrong = compare(bench, SEED, tries(60, 3_000), bench.cyclone)
    assert wrong == []
    assert counts["cyclone"] > tries(8_000, 400_000)
    assert counts["cyclone allows"] > tries(500, 25_000)


@on_each_fastdds
def test_fast_dds_decides_as_brute_force_does(bench: Bench, vendor: Vendor, tmp_path: Path) -> None:
    counts, wrong = compare(bench, SEED, tries(12, 100), partial(bench.fast, vendor, tmp_path))
    assert wrong == []
    assert counts["fastdds"] > tries(500, 5_000)
    assert counts["fastdds allows"] > tries(30, 250)
