# SPDX-License-Identifier: Apache-2.0
"""Newer versions of vendors run with their own libraries, whatever the machine has."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from .conftest import NEWER, param
from .handmade import Authorities, criteria, rule

if TYPE_CHECKING:
    from keymint_ros2_dds.vendors.participants import System, Vendor


@pytest.mark.parametrize("vendor", list(map(param, NEWER)), indirect=True)
def test_no_library_of_the_machine_is_loaded(
    authorities: Authorities, vendor: Vendor, system: System, tmp_path: Path
) -> None:
    assert vendor.version is not None
    participant = system.open(authorities.enclave(tmp_path, rule("allow", criteria("publish", ["rt/x"]))))
    maps = Path(f"/proc/{participant._process._process.pid}/maps").read_text().splitlines()
    loaded = {Path(line.split()[-1]) for line in maps if ".so" in line}
    assert len(loaded) > 5
    assert [path for path in loaded if not path.is_relative_to(vendor.version.libraries.resolve())] == []
