# SPDX-License-Identifier: Apache-2.0
"""Fixtures for tests on real DDS software. If a vendor is missing, they skip and report what to install.

With ``KEYMINT_REQUIRE_VENDORS=1`` in the environment (as in CI) a missing vendor is a failure; for the newer versions
that ``make vendors-new`` unpacks, this takes ``KEYMINT_REQUIRE_NEW_VENDORS=1``.
"""

from __future__ import annotations

import os
from collections import Counter
from datetime import UTC, datetime
from functools import cache
from typing import TYPE_CHECKING, NoReturn

import pytest
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, VARIATIONS, Variation
from keymint_ros2_dds.transports import real_cyclonedds, real_cyclonedds_0_10_5, real_fastdds, real_fastdds_3
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.participants import CycloneDDS, FastDDS, System, Vendor
from keymint_ros2_dds.vendors.probe_builds import unpacked_version
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohSystem, installed_version

from keymint import cli
from keymint.api import Availability, Environment, Tier, Transport
from keymint.host.vendor_process import MissingVendorError
from tests.effort import FULL

from .handmade import Authorities
from .provisioning import provision
from .zenoh_system import ZenohTestSystem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


NEWER = {
    "cyclonedds-0.10.5": (CycloneDDS, probe_builds.CYCLONEDDS),
    "fastdds-3.1.2": (FastDDS, probe_builds.FASTDDS_3),
    "fastdds-3.3.0": (FastDDS, probe_builds.FASTDDS_3),
}
"""Versions in the cache: their vendor, and how to build its probe."""
CASES = 1
"""Of the cases of a test, so many run on a newer version; with ``KEYMINT_FULL=1`` all."""
UNPACKED = cli._cache() / "vendors"
SAMPLED = (
    "cyclonedds-0.10.5",
    "fastdds-3",
    "fastdds-3.1.2" if not (UNPACKED / "fastdds-3.3.0").exists() else "fastdds-3.3.0",
)
"""Newer versions on which tests run at all without it: of each vendor the latest that there is; and transports."""


def param(name: str) -> pytest.ParameterSet:
    """Return the name of a vendor, of a version in the cache, or of a transport, with its marks."""
    vendor, _, version = name.partition("-")
    marks = [getattr(pytest.mark, vendor), *([pytest.mark.newer_vendor(name)] if version else [])]
    return pytest.param(name, marks=marks)


CYCLONEDDS, FASTDDS = (
    [param(name) for name in (vendor, *NEWER) if name.startswith(vendor)] for vendor in ("cyclonedds", "fastdds")
)
on_each_fastdds = pytest.mark.parametrize("vendor", FASTDDS, indirect=True)
on_each_cyclonedds = pytest.mark.parametrize("vendor", CYCLONEDDS, indirect=True)
"""Marks of tests on one vendor, whose argument is ``vendor``."""
TRANSPORTS = {
    "cyclonedds": (real_cyclonedds, "cyclonedds-0.10"),
    "cyclonedds-0.10.5": (real_cyclonedds_0_10_5, "cyclonedds-0.10"),
    "fastdds": (real_fastdds, "fastdds-2.9"),
    "fastdds-3": (real_fastdds_3, "fastdds-3.3"),
}
"""The real transports, and the names of the models of their vendors."""
REAL_TRANSPORTS = list(map(param, TRANSPORTS))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect cases of newer versions beyond a sample."""
    seen, left_out = Counter[tuple[object, ...]](), set[pytest.Item]()
    for item in items:
        if (mark := item.get_closest_marker("newer_vendor")) and not FULL:
            case = (item.path, item.function, *mark.args)  # type: ignore[attr-defined]
            seen[case] += 1
            if seen[case] > CASES or mark.args[0] not in SAMPLED:
                left_out.add(item)
    if left_out:
        config.hook.pytest_deselected(items=[*left_out])
        items[:] = [item for item in items if item not in left_out]


def missing(error: MissingVendorError, required: str = "KEYMINT_REQUIRE_VENDORS") -> NoReturn:
    """Skip the test, or fail it if vendors are required: if this variable is 1."""
    if os.environ.get(required) == "1":
        pytest.fail(f"{required}=1, but {error}", pytrace=False)
    pytest.skip(str(error))


def missing_transport(usable: Availability, name: str = "transport") -> NoReturn:
    """Skip or fail in the same way if a transport is unusable."""
    required = "KEYMINT_REQUIRE_NEW_VENDORS" if "-" in name else "KEYMINT_REQUIRE_VENDORS"
    missing(MissingVendorError(name, usable.reason, usable.help), required)


def environment() -> Environment:
    """Return the environment of transports; the newer versions are in this user's cache."""
    return Environment(datetime.now(UTC), cli._cache(), {"PATH": os.environ["PATH"]})


def usable_transport(name: str) -> Transport:
    """Return a real transport; skip the test, or fail it, if there is none of all tiers."""
    opened = TRANSPORTS[name][0].open(environment())
    usable = opened.usable()
    if Tier.EXCHANGE not in usable.tiers:
        missing_transport(usable, name)
    return opened


def variation_of(vendor: Vendor) -> Variation:
    """Return the model of a vendor; skip the test if there is none of its version."""
    if isinstance(vendor, CycloneDDS):
        return CYCLONEDDS_0_10
    return FASTDDS_2_9 if vendor.version is None else variation("fastdds-3.3")


def variation(name: str) -> Variation:
    """Return a model by its name; skip the test if there is none."""
    if name not in VARIATIONS:
        pytest.skip(f"there is no model {name}")
    return VARIATIONS[name]


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


@pytest.fixture(scope="session")
def newer(probe_cache: Path) -> Callable[[str], Vendor]:
    """Return a function that returns a version in the cache."""

    @cache
    def opened(name: str) -> Vendor:
        vendor, probe = NEWER[name]
        version = unpacked_version(cli._cache(), [name])
        return vendor(version.built(probe).build(probe_cache, {}), version=version)

    return opened


@pytest.fixture(params=[*CYCLONEDDS, *FASTDDS])
def vendor(request: pytest.FixtureRequest, newer: Callable[[str], Vendor]) -> Vendor:
    """Return each vendor in turn, in each version."""
    if request.param not in NEWER:
        found: Vendor = request.getfixturevalue(request.param)
        return found
    try:
        return newer(request.param)
    except MissingVendorError as error:
        missing(error, "KEYMINT_REQUIRE_NEW_VENDORS")


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
