# SPDX-License-Identifier: Apache-2.0
"""The harness itself: missing vendors are visible, and no process or port outlives its test."""

from __future__ import annotations

import dataclasses
import os
import stat
from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.participants import FastDDS, System

from keymint.host import vendor_process
from keymint.host.vendor_process import MissingVendorError, ProcessFailedError

from .conftest import missing

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def absent(tmp_path: Path) -> MissingVendorError:
    """Raised if a vendor's headers are not installed."""
    probe = dataclasses.replace(probe_builds.CYCLONEDDS, compilers=("cc", "gcc", "c++", "g++"), header="dds/absent.h")
    with pytest.raises(MissingVendorError) as raised:
        probe.build(tmp_path, {})
    return raised.value


def test_a_missing_vendor_skips_the_test_with_a_line_that_explains_how_to_install_it(
    absent: MissingVendorError, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("KEYMINT_REQUIRE_VENDORS", raising=False)
    with pytest.raises(pytest.skip.Exception, match=r"^Cyclone DDS: no .*; apt-get install .*cyclonedds-dev"):
        missing(absent)


def test_a_missing_vendor_fails_the_test_if_vendors_are_required(
    absent: MissingVendorError, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KEYMINT_REQUIRE_VENDORS", "1")
    with pytest.raises(pytest.fail.Exception, match="KEYMINT_REQUIRE_VENDORS=1, but Cyclone DDS: no "):
        missing(absent)


def test_a_missing_compiler_is_a_missing_vendor(tmp_path: Path) -> None:
    probe = dataclasses.replace(probe_builds.FASTDDS, compilers=("absent-compiler",))
    with pytest.raises(MissingVendorError, match="Fast DDS: no compiler absent-compiler"):
        probe.build(tmp_path, {})


@pytest.fixture
def impostor(tmp_path: Path) -> FastDDS:
    """A program that replaces a probe: it records its process id, opens, and then never answers."""
    program = tmp_path / "probe"
    program.write_text(f"#!/bin/sh\necho $$ >>{tmp_path}/pids\nread line\necho OPENED\nexec sleep 600\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return FastDDS(program)


def test_no_process_outlives_its_system(impostor: FastDDS, tmp_path: Path) -> None:
    def failing() -> None:
        with System(impostor) as system:
            system.open(tmp_path)
            system.open(tmp_path)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing()
    pids = [int(pid) for pid in (tmp_path / "pids").read_text().split()]
    assert len(pids) == 2
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_probe_that_hangs_is_an_error(impostor: FastDDS, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vendor_process, "GRACE_SECONDS", 0.1)
    with System(impostor) as system:
        participant = system.open(tmp_path)
        with pytest.raises(ProcessFailedError, match="did not answer"):
            participant.edge("publish", "rt/x")


def test_simultaneous_systems_have_different_ports(impostor: FastDDS) -> None:
    with System(impostor) as one, System(impostor) as other:
        assert one.first_port != other.first_port
