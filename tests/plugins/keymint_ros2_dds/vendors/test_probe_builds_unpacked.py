# SPDX-License-Identifier: Apache-2.0
"""Newer versions in the cache: which one is chosen, who may have written it, and how ``make vendors-new`` fails."""

from __future__ import annotations

import os
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest
from keymint_ros2_dds.transports import real_cyclonedds_0_10_5, real_fastdds_3
from keymint_ros2_dds.vendors.participants import FastDDS
from keymint_ros2_dds.vendors.probe_builds import FASTDDS_3, unpacked_version

from keymint.api import Environment, Tier, Transport
from keymint.host.vendor_process import MissingVendorError
from tests.conftest import CHECKOUT

NAMES = ("fastdds-3.3.0", "fastdds-3.1.2")
TRIPLET = "some-linux-gnu"


def version(cache: Path, name: str) -> Path:
    """Make the files of a version that are looked for, and return its folder of libraries."""
    libraries = cache / "vendors" / name / "usr/lib" / TRIPLET
    libraries.mkdir(parents=True)
    (cache / "vendors").chmod(0o700)
    (libraries / "ld-linux-some.so.2").touch()
    return libraries


def opened(transport: object, cache: Path, path: str = os.defpath) -> Transport:
    return transport.open(Environment(datetime.now(UTC), cache, {"PATH": path}))  # type: ignore[attr-defined]


def test_the_first_that_is_there_is_chosen(tmp_path: Path) -> None:
    older = version(tmp_path, NAMES[1])
    assert (unpacked_version(tmp_path, NAMES).version, unpacked_version(tmp_path, NAMES).libraries) == ("3.1.2", older)
    version(tmp_path, NAMES[0])
    assert unpacked_version(tmp_path, NAMES).version == "3.3.0"


def test_what_others_may_write_is_not_run(tmp_path: Path) -> None:
    version(tmp_path, NAMES[0])
    (tmp_path / "vendors").chmod(0o777)
    with pytest.raises(MissingVendorError, match="others may write"):
        unpacked_version(tmp_path, NAMES)


def test_half_a_version_is_none(tmp_path: Path) -> None:
    (version(tmp_path, NAMES[0]) / "ld-linux-some.so.2").unlink()
    with pytest.raises(
        MissingVendorError, match=r"no fastdds-3\.3\.0 or fastdds-3\.1\.2 in .*vendors; 'make vendors-new'"
    ):
        unpacked_version(tmp_path, NAMES)


def test_a_program_is_built_and_started_with_its_own_libraries(tmp_path: Path) -> None:
    libraries = version(tmp_path, NAMES[0])
    found = unpacked_version(tmp_path, NAMES)
    headers = libraries.parent.parent / "include"
    assert found.built(FASTDDS_3).folders[:3] == (f"-I{headers}", f"-I{headers / TRIPLET}", f"-L{libraries}")
    command = FastDDS(tmp_path / "probe", version=found).command
    assert command == (f"{libraries}/ld-linux-some.so.2", "--library-path", str(libraries), f"{tmp_path}/probe")


@pytest.mark.parametrize("transport", [real_fastdds_3, real_cyclonedds_0_10_5])
def test_a_transport_that_is_not_there_says_how_to_get_it(transport: object, tmp_path: Path) -> None:
    usable = opened(transport, tmp_path).usable()
    assert (usable.usable, usable.tiers) == (False, ())
    assert "make vendors-new" in usable.help


def test_it_is_used_only_when_named(tmp_path: Path) -> None:
    version(tmp_path, NAMES[0])
    usable = opened(real_fastdds_3, tmp_path, os.environ["PATH"]).usable()
    assert (usable.usable, usable.by_default, usable.version) == (True, False, "3.3.0")
    assert usable.tiers == tuple(Tier)
    assert not opened(real_fastdds_3, tmp_path, str(tmp_path)).usable().usable, "no compiler"


@pytest.mark.parametrize(("required", "code"), [("", 0), ("1", 1)])
def test_where_it_cannot_be_unpacked_one_line_says_so(tmp_path: Path, required: str, code: int) -> None:
    """Here because there is no apt-get; offline and on Ubuntu the same line has another reason."""
    path = tmp_path / "bin"
    path.mkdir()
    (path / "apt-get").write_text("#!/bin/sh\nexit 1\n")
    (path / "apt-get").chmod(0o755)
    environment = {
        "PATH": f"{path}:{os.environ['PATH']}", "XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path),
        "KEYMINT_REQUIRE_NEW_VENDORS": required,
    }  # fmt: skip
    command = [CHECKOUT / ".ci/setup-vendors-new.sh"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (code, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("setup-vendors-new: tests skip for lack of fastdds-3.1.2 (")
    assert "cyclonedds-0.10.5 (" in line
    assert list((tmp_path / "cache/keymint/vendors").iterdir()) == []


def test_what_is_there_is_not_fetched_again(tmp_path: Path) -> None:
    for name in (*NAMES, "cyclonedds-0.10.5"):
        version(tmp_path / "keymint", name)
    environment = {"PATH": "/usr/bin:/bin", "XDG_CACHE_HOME": str(tmp_path), "http_proxy": "http://127.0.0.1:9/"}
    command = [CHECKOUT / ".ci/setup-vendors-new.sh"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
