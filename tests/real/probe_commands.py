# SPDX-License-Identifier: Apache-2.0
"""Commands of the probes of real vendors that only tests send."""

from __future__ import annotations

from typing import TYPE_CHECKING

from keymint.host.vendor_process import GRACE_SECONDS

if TYPE_CHECKING:
    from keymint_ros2_dds.vendors.participants import ProbeEndpoint, ProbeParticipant


class MatchedError(Exception):
    """A peer matches although none should."""


def await_rejection(endpoint: ProbeEndpoint, seconds: float) -> str | None:
    """Wait until the vendor rejects a peer; return why, or None if nothing happens in time.

    Raises:
        MatchedError: a peer matches.
    """
    milliseconds = str(round(seconds * 1000))
    answer, reason = endpoint._process.ask("AWAIT", endpoint._name, milliseconds, seconds=seconds)
    if answer == "MATCHED":
        raise MatchedError
    return reason or None


def close(participant: ProbeParticipant) -> None:
    """Delete a participant, and wait until its process has ended."""
    process = participant._process
    answer, _ = process.ask("CLOSE")
    assert (answer, process._process.wait(timeout=GRACE_SECONDS)) == ("CLOSED", 0)
    process.reap()
