# SPDX-License-Identifier: Apache-2.0
"""The policy of a navigation stack, one enclave for a dozen nodes, fits into the handshakes of real vendors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.participants import System

from benchmarks import navigation

from .probe_commands import await_rejection
from .provisioning import enclave

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture(scope="module")
def install(provisioned: Callable[[str | Path], Path]) -> Path:
    """Return the keystore of two enclaves, each with all permissions of the navigation stack."""
    policy = navigation.policy()
    peer = policy.replace('name="navigation"', 'name="peer"').replace(">/navigation<", ">/peer<")
    end = policy.rindex("</profiles>")
    return provisioned(policy[:end] + peer[peer.index("<profile name") :])


def test_samples_are_exchanged(install: Path, system: System) -> None:
    """Not on Fast DDS 3.1.2, where no handshake succeeds with more than some 6 kB."""
    sizes = [(enclave(install, subject) / "permissions.p7s").stat().st_size for subject in ("/navigation", "/peer")]
    assert all(55_000 < size < 60_000 for size in sizes), sizes
    writer = system.open(enclave(install, "/navigation")).edge("publish", "rt/cmd_vel_smoothed")
    reader = system.open(enclave(install, "/peer")).edge("subscribe", "rt/cmd_vel_smoothed")
    writer.write("hello")
    version = system.vendor.version
    if version is not None and version.version == "3.1.2":
        assert "Cannot serialize ParticipantGenericMessage" in str(await_rejection(reader, 10.0))
    else:
        assert reader.read() == "hello"
