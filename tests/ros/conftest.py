# SPDX-License-Identifier: Apache-2.0
"""``make test-ros``: tests on the ROS 2 that is sourced, in a network of their own; no other run collects them.

Nodes are processes of the Python of ROS; Keymint and pytest keep theirs. With ``KEYMINT_REQUIRE_ROS=1`` (as in CI) a
missing ROS 2, or a machine where no network can be made, is a failure in place of a skip.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from keymint_ros2_dds.vendors.ros_network import RosNetwork

from keymint.host.vendor_process import MissingVendorError

from .ros_system import RosSystem

if os.environ.get("KEYMINT_TEST_ROS") != "1":
    collect_ignore_glob = ["test_*.py"]

COUNTS: Counter[str] = Counter()
"""What the tests of this run have tried, for the report at the end."""


SOURCED = dict(os.environ)
"""The environment with ROS 2 in it, before tests change theirs."""
if _modules := SOURCED.pop("KEYMINT_ROS_PYTHONPATH", ""):
    SOURCED["PYTHONPATH"] = _modules  # pytest itself runs without, because it would load the plugins there


@pytest.fixture(scope="session")
def usable() -> None:
    """Require a ROS 2 that can be run apart from all others."""
    try:
        with RosNetwork(SOURCED):
            pass
    except MissingVendorError as error:
        if os.environ.get("KEYMINT_REQUIRE_ROS") == "1":
            pytest.fail(f"KEYMINT_REQUIRE_ROS=1, but {error}", pytrace=False)
        pytest.skip(str(error))


@pytest.fixture
def ros(usable: None, tmp_path: Path) -> Iterator[RosSystem]:
    """Return a network without nodes; all its processes end with the test."""
    with RosNetwork(SOURCED) as network:
        yield RosSystem(network, tmp_path)


@pytest.fixture(scope="session")
def counts() -> Counter[str]:
    """Return the counts of the report."""
    return COUNTS


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Let a worker of pytest-xdist hand over its counts."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["counts"] = dict(COUNTS)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Add the counts of a worker."""
    COUNTS.update(node.workeroutput.get("counts", {}) if hasattr(node, "workeroutput") else {})


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Report what was tried."""
    for what, count in sorted(COUNTS.items()):
        terminalreporter.write_line(f"{count:6} {what}")
