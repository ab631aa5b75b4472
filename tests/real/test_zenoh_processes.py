# SPDX-License-Identifier: Apache-2.0
"""Processes of real Zenoh sessions: what their mailboxes say about the order of samples."""

from __future__ import annotations

import json

import pytest
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohSystem

pytestmark = pytest.mark.zenoh

_BOXES = [f"box{number}" for number in range(300)]
_PEER = {"mode": "peer", "listen": {"endpoints": []}, "scouting": {"multicast": {"enabled": False}}}


def test_when_a_sample_is_in_a_mailbox_all_that_were_sent_before_it_are_in_theirs(zenoh_system: ZenohSystem) -> None:
    """Fences rely on it: that one sample arrived says that the samples before it arrived or never will."""
    process = zenoh_system.start()
    process.open("own", zenoh_system.file("own.json5", json.dumps(_PEER).encode()), {})
    process.ask("subscribe", session="own", keys={**dict.fromkeys(_BOXES, "attack"), "fence": "fence"})
    process.ask("put", session="own", samples=[*[("attack", "attack")] * 10, ("fence", "end")])
    boxes = process.ask("received", names=["fence", *_BOXES], last="end", wait=10.0)
    assert len(boxes["fence"]) == 1
    assert {len(boxes[box]) for box in _BOXES} == {10}
