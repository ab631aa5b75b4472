# SPDX-License-Identifier: Apache-2.0
"""Random policies with names of ROS 2 Ardent: real access control decides topics and partitions as the policy does."""

from __future__ import annotations

import itertools
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from keymint_ros2_dds import build_type

from keymint.api import BuildOptions, Validity
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.compiling.test_grant_compiler import built_or_refused
from tests.plugins.keymint_ros2_dds.lowering.test_name_mapping_ardent import ASKED, TOPICS, drawn_rules, permitted
from tests.plugins.keymint_ros2_dds.packages import package

from .agreement import access, participant
from .conftest import on_each_fastdds

if TYPE_CHECKING:
    from pathlib import Path

    from keymint_ros2_dds.vendors.participants import Vendor

    from .handmade import Authorities

REAL_TOPICS = [topic for topic in TOPICS if "]" not in topic]


def documents(rules) -> tuple[str, str] | None:
    """Compile rules for the subject ``/talker``; return None if they are rejected or allow nothing."""
    now = datetime.now(UTC).replace(microsecond=0)
    validity = Validity(now - timedelta(days=2), now + timedelta(days=10))
    loaded = package(*rules, distro="ardent", name="CN=/talker", validity=validity)
    if built_or_refused(loaded) is None:
        return None
    built = build_type.build(loaded, BuildOptions()).documents
    permissions = built["permissions.xml"].decode()
    return (permissions, built["governance.xml"].decode()) if "<allow_rule>" in permissions else None


def expect(rules, allows, topics) -> None:
    for action, topic, asked in itertools.product(("publish", "subscribe"), topics, ASKED):
        wanted, decided = permitted(rules, action, topic, asked), allows(action, topic, asked)
        assert decided == wanted or ("/" in topic and not decided), (action, topic, asked, wanted)


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@settings(max_examples=tries(30, 60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(drawn=st.lists(drawn_rules(), min_size=1, max_size=5))
def test_the_access_control_of_cyclone_dds_agrees(authorities: Authorities, drawn) -> None:
    found = documents(drawn)
    if found is not None:
        with access(authorities, "/talker", found) as opened:
            expect(drawn, opened.allows, TOPICS)


@on_each_fastdds
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(drawn=st.lists(drawn_rules(), min_size=1, max_size=5))
def test_participants_of_fast_dds_agree(vendor: Vendor, authorities: Authorities, tmp_path: Path, drawn) -> None:
    found = documents(drawn)
    if found is not None:
        with participant(
            vendor, authorities, tmp_path / str(len(list(tmp_path.iterdir()))), "/talker", found
        ) as opened:
            assert opened is not None
            expect(drawn, opened.allows, REAL_TOPICS)
