# SPDX-License-Identifier: Apache-2.0
"""Fixtures for tests on real DDS software. If a vendor is missing, they skip and report what to install.

With ``KEYMINT_REQUIRE_VENDORS=1`` in the environment (as in CI) a missing vendor is a failure.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NoReturn

import pytest
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.participants import CycloneDDS, FastDDS, System, Vendor
from keymint_ros2_zenoh.vendors.zenoh_library import installed_version
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohSystem

from keymint.api import Availability
from keymint.command_process import MissingVendorError

from .handmade import Authorities
from .provisioning import provision
from .zenoh_system import ZenohTestSystem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


def missing(error: MissingVendorError) -> NoReturn:
    """Skip the test, or fail it if vendors are required."""
    if os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
        pytest.fail(f"KEYMINT_REQUIRE_VENDORS=1, but {error}", pytrace=False)
    pytest.skip(str(error))


def missing_transport(usable: Availability) -> NoReturn:
    """Skip or fail in the same way if a transport is unusable."""
    missing(MissingVendorError("transport", usable.reason, usable.help))


@pytest.fixture(scope="session")
def probe_cache(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that caches the built probes between runs."""
    cache = getattr(pytestconfig, "cache", None)
    if cache is None:
        return tmp_path_factory.mktemp("probes")
    folder: Path = cache.mkdir("probes")
    folder.chmod(0o700)  # programs run from this folder, so nobody else may write to it
    return folder


@pytest.fixture(scope="session")
def cyclone_plugins() -> None:
    """Require the security plugins of Cyclone DDS."""
    try:
        probe_builds.require_cyclone_plugins()
    except MissingVendorError as error:
        missing(error)


@pytest.fixture(scope="session")
def cyclonedds(cyclone_plugins: None, probe_cache: Path) -> Vendor:
    """Return Cyclone DDS."""
    try:
        return CycloneDDS(probe_builds.CYCLONEDDS.build(probe_cache, {}))
    except MissingVendorError as error:
        missing(error)


@pytest.fixture(scope="session")
def fastdds(probe_cache: Path) -> Vendor:
    """Return Fast DDS."""
    try:
        return FastDDS(probe_builds.FASTDDS.build(probe_cache, {}))
    except MissingVendorError as error:
        missing(error)


@pytest.fixture(scope="session")
def zenoh_library() -> str:
    """Require Zenoh; return its version."""
    try:
        return installed_version()
    except MissingVendorError as error:
        missing(error)


@pytest.fixture
def zenoh_system(zenoh_library: str) -> Iterator[ZenohSystem]:
    """Return a system without processes; its processes end with the test."""
    with ZenohTestSystem(os.environ) as opened:
        yield opened


@pytest.fixture(
    params=[
        pytest.param("cyclonedds", marks=pytest.mark.cyclonedds),
        pytest.param("fastdds", marks=pytest.mark.fastdds),
    ]
)
def vendor(request: pytest.FixtureRequest) -> Vendor:
    """Return each vendor in turn."""
    found: Vendor = request.getfixturevalue(request.param)
    return found


@pytest.fixture
def system(vendor: Vendor) -> Iterator[System]:
    """Return a system of a vendor without participants; its participants end with the test."""
    with System(vendor) as opened:
        yield opened


@pytest.fixture(scope="session")
def authorities() -> Authorities:
    """Return two authorities for handmade enclaves."""
    return Authorities.new()


@pytest.fixture(scope="session")
def provisioned(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str | Path], Path]:
    """Return a function that provisions a policy as a new system, and returns its install space."""
    return lambda policy: provision(policy, tmp_path_factory.mktemp("system"))
