# SPDX-License-Identifier: Apache-2.0
"""Legal ROS names: ``/`` and segments of letters, digits and ``_`` that do not begin with a digit.

Source: ROS 2 design, "Topic and Service name mapping to DDS".
"""

from __future__ import annotations

from comarmor.regex import lazy_regex

RAW_PREFIXES = ("rt/", "rq/", "rr/", "rs/", "ra/")
"""What ROS 2 puts before the names of raw topics: of topics, requests, replies, services and actions."""
_SEGMENT = lazy_regex(r"[A-Za-z_][A-Za-z0-9_]*")
_FULLY_QUALIFIED = lazy_regex(rf"(?:/{_SEGMENT.pattern})+")


def is_segment(text: str) -> bool:
    """Whether a text is a legal segment of a ROS name, e.g. ``talker``."""
    return _SEGMENT.fullmatch(text) is not None


def is_fully_qualified(name: str) -> bool:
    """Whether a text is a legal fully qualified ROS name, e.g. ``/robot1/talker``."""
    return _FULLY_QUALIFIED.fullmatch(name) is not None


def is_subject(name: str) -> bool:
    """Whether a text is a legal name of a subject: a fully qualified name, or ``/``, the root enclave."""
    return name == "/" or is_fully_qualified(name)
