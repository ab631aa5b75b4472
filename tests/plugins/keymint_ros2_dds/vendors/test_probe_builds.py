# SPDX-License-Identifier: Apache-2.0
"""Compiled probes come from a place that is ours alone, or are built in one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.probe_builds import FASTDDS_NONCONFORMING as PROBE

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no compiler")
ENVIRONMENT = {"PATH": os.environ.get("PATH", os.defpath)}
FORGED = b"#!/bin/sh\nexit 0\n"
AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
Damage = Callable[[Path, Path], None]


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    return tmp_path / "cache" / "keymint" / "probes"


def forge(program: Path) -> None:
    program.unlink()
    program.write_bytes(FORGED)
    program.chmod(0o755)


def of_another_user(_cache: Path, program: Path) -> None:
    forge(program)
    os.chown(program, 12345, -1)


def writable(_cache: Path, program: Path) -> None:
    forge(program)
    program.chmod(0o775)


def a_link(cache: Path, program: Path) -> None:
    program.rename(cache.parent.parent / "elsewhere")
    program.symlink_to(cache.parent.parent / "elsewhere")


def a_second_name(cache: Path, program: Path) -> None:
    forge(program)
    os.link(program, cache.parent.parent / "elsewhere")


def a_folder(_cache: Path, program: Path) -> None:
    program.unlink()
    program.mkdir()


def open_cache(cache: Path, program: Path) -> None:
    forge(program)
    cache.chmod(0o777)


def open_above(cache: Path, program: Path) -> None:
    forge(program)
    cache.parent.chmod(0o777)


def cache_of_another_user(cache: Path, program: Path) -> None:
    forge(program)
    os.chown(cache, 12345, -1)


def above_of_another_user(cache: Path, program: Path) -> None:
    forge(program)
    os.chown(cache.parent.parent, 12345, -1)


def a_cache_that_is_a_link(cache: Path, program: Path) -> None:
    forge(program)
    cache.rename(cache.parent / "elsewhere")
    cache.symlink_to(cache.parent / "elsewhere")


@pytest.mark.parametrize(
    "damage",
    [
        *(
            pytest.param(each, marks=AS_ROOT)
            for each in (of_another_user, cache_of_another_user, above_of_another_user)
        ),
        *(writable, a_second_name, open_cache, open_above, a_cache_that_is_a_link, a_link, a_folder),
    ],
)
def test_a_program_of_someone_else_is_not_run(cache: Path, damage: Damage) -> None:
    built = PROBE.build(cache, ENVIRONMENT)
    genuine = built.read_bytes()
    assert built.parent == cache
    assert cache.stat().st_mode & 0o777 == 0o700
    assert PROBE.build(cache, ENVIRONMENT) == built
    damage(cache, built)
    again = PROBE.build(cache, ENVIRONMENT)
    assert probe_builds.is_ours(again)
    assert probe_builds.is_ours_alone(again.parent)
    assert (again.read_bytes()[:4], FORGED in again.read_bytes()) == (genuine[:4], False)


def test_what_is_ours_is_not_built_again(cache: Path) -> None:
    built = PROBE.build(cache, ENVIRONMENT)
    before = built.stat().st_mtime_ns
    assert PROBE.build(cache, ENVIRONMENT).stat().st_mtime_ns == before


def test_a_sticky_folder_above_is_no_danger(cache: Path) -> None:
    cache.parent.parent.mkdir()
    cache.parent.parent.chmod(0o1777)
    assert PROBE.build(cache, ENVIRONMENT).parent == cache


def test_a_cache_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    built = PROBE.build(tmp_path / "file" / "probes", ENVIRONMENT)
    assert probe_builds.is_ours_alone(built.parent)
