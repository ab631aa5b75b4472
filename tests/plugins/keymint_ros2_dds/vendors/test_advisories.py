# SPDX-License-Identifier: Apache-2.0
"""Known vulnerabilities: which versions of vendors they affect, and which versions are installed."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_dds.vendors.advisories import ADVISORIES, advisories, affects, installed_vendors, number

VERSIONS = st.tuples(st.integers(0, 12), st.integers(0, 16), st.integers(0, 14)).map(
    lambda each: ".".join(map(str, each))
)
BY_CVE = {each.cve[:14]: each for each in ADVISORIES}


@pytest.mark.parametrize(
    ("cve", "affected", "fixed"),
    [
        ("CVE-2023-24010", "2.9.1 2.6.4 2.7.0 2.8.1", "2.9.2 2.6.5 2.8.2 2.10.0 2.14.1 3.2.0"),
        ("CVE-2023-24011", "0.7.0 0.10.2 0.10.5", "11.0.0 11.0.1"),
        ("CVE-2025-24807", "2.6.9 2.9.1 2.14.4 3.1.1 2.11.3", "2.6.10 2.14.5 3.1.2 3.2.0 3.3.0 2.14.10"),
        ("CVE-2025-67108", "2.6.11 2.14.6 3.2.4 3.3.0 3.6.2", "2.6.12 2.14.7 3.2.5"),
        ("CVE-2025-67109", "0.10.4", "0.10.5 11.0.1"),
        ("CVE-2026-45094", "2.6.11 3.2.4 3.3.1 3.5.0 3.6.1", "2.6.12 2.14.7 3.2.5 3.4.3 3.6.2"),
    ],
)
def test_whom_an_advisory_affects(cve: str, affected: str, fixed: str) -> None:
    assert [affects(BY_CVE[cve], each) for each in affected.split()] == [True] * len(affected.split())
    assert [affects(BY_CVE[cve], each) for each in fixed.split()] == [False] * len(fixed.split())


@given(VERSIONS, st.integers(1, 5))
def test_a_later_version_of_a_line_has_what_an_earlier_one_has_mended(version: str, more: int) -> None:
    *line, patch = number(version)
    later = ".".join(map(str, (*line, patch + more)))
    for each in ADVISORIES:
        assert affects(each, version) or not affects(each, later), each.cve


def test_the_table_says_where_it_is_from_and_what_it_does_not_know() -> None:
    assert all(each.source and each.what and len(each.date) == 10 for each in ADVISORIES)
    (found,) = (each for each in advisories("fastdds", "3.3.1") if "CVE-2025-67108" in each.message)
    assert (found.code, found.severity) == ("vendor-advisory", "warning")
    assert "of other lines the fixed version is unknown" in found.message


def test_versions_of_sourced_ros_and_of_packages_are_found(tmp_path: Path) -> None:
    share = tmp_path / "jazzy/share/fastrtps"
    share.mkdir(parents=True)
    (share / "package.xml").write_text("<package><name>fastrtps</name><version>2.14.4</version></package>")
    query = tmp_path / "bin/dpkg-query"
    query.parent.mkdir()
    query.write_text(
        "#!/bin/sh\nprintf 'installed ros-jazzy-cyclonedds 0.10.5-1noble\\ninstalled libddsc0debian 0.10.2-2\\n"
        "not-installed libfastrtps2.9 \\ninstalled ros-jazzy-rmw-fastrtps-cpp 8.4.1-1\\n'\n"
    )
    query.chmod(0o755)
    environment = {"PATH": str(query.parent), "AMENT_PREFIX_PATH": f"{tmp_path}/none:{tmp_path}/jazzy"}
    assert installed_vendors(environment) == {"cyclonedds": ("0.10.5", "0.10.2"), "fastdds": ("2.14.4",)}
    assert installed_vendors({"PATH": str(tmp_path)}) == {}
