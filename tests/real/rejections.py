# SPDX-License-Identifier: Apache-2.0
"""Wait until a participant of a real vendor rejects its peer."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from keymint_ros2_dds.vendors.participants import ProbeEndpoint


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
