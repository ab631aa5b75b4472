# SPDX-License-Identifier: Apache-2.0
"""A sample of the comparisons of ``benchmarks/open_governance.py``."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from keymint_ros2_dds.vendors.participants import Vendor


@pytest.fixture
def benchmark() -> dict[str, Any]:
    folder = Path(__file__).resolve().parents[2] / "benchmarks"
    if not folder.is_dir():
        pytest.skip("no benchmarks beside these tests")
    sys.path.insert(0, str(folder))
    try:
        return runpy.run_path(str(folder / "open_governance.py"))
    finally:
        sys.path.remove(str(folder))


def test_claims_and_models_agree_with_brute_force(benchmark: dict[str, Any]) -> None:
    counts, wrong = benchmark["compare"](11, 100, cyclone=False)
    assert wrong == []
    assert counts["model"] > 30_000
    assert min(counts["differing"], counts["claims proven"], counts["claims counterexample"]) > 100


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
def test_cyclone_dds_decides_as_brute_force_does(benchmark: dict[str, Any]) -> None:
    counts, wrong = benchmark["compare"](12, 60)
    assert wrong == []
    assert counts["cyclone"] > 8_000
    assert counts["cyclone allows"] > 500


@pytest.mark.fastdds
def test_fast_dds_decides_as_brute_force_does(benchmark: dict[str, Any], fastdds: Vendor) -> None:
    counts, wrong = benchmark["compare"](13, 12, cyclone=False, fastdds=fastdds, fast_documents=12)
    assert wrong == []
    assert counts["fastdds"] > 500
    assert counts["fastdds allows"] > 30
