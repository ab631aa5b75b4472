# SPDX-License-Identifier: Apache-2.0
"""The suite itself: tests of a group run in one process, so that their fixtures are made once."""

from __future__ import annotations

import os

import pytest


@pytest.mark.xdist_group("groups")
@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="this run has one process")
def test_a_group_is_known_to_what_distributes_tests(request: pytest.FixtureRequest) -> None:
    """pytest-xdist 3.8 appends it to the id of a test, which pytest 9.2 would ignore."""
    if request.config.getoption("loadgroup", default=False):
        assert request.node.nodeid.endswith("@groups")
