# SPDX-License-Identifier: Apache-2.0
"""Hypothesis strategies for ComArmor policies of one subject, with few names, so that rules often overlap."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

from hypothesis import strategies as st

from .agreement import REQUESTS, operations

if TYPE_CHECKING:
    from collections.abc import Sequence

NAMES = ("/x", "/xy", "/x/y", "/y", "/y/x", "/r/x", "/r/a", "/r/a/x", "/b", "/z")
RAW_NAMES = ("raw", "rawx", "raw/x", "raw/x/y")
PARTITIONS: tuple[Sequence[str], ...] = ((), ("",), ("p",), ("p", "q"), ("p", ""))

ENDPOINTS = sorted(
    {each for (_, permission), name in product(REQUESTS, NAMES) for each in operations(permission, name)}
    | {each for name in ("raw", "rt", "rt/x/", "rqx") for each in operations("publish", name)}
)
RAW_ENDPOINTS = [each for held, name in product(("publish", "subscribe"), RAW_NAMES) for each in operations(held, name)]

_EXPRESSIONS = (
    *NAMES,
    *("*", "/*", "/x*", "/x/*", "*/x", "/?", "/x?", "/[xy]", "/[!x]", "/r/*", "*y", "/*/x"),
    *("{namespace}x", "{namespace}{name}", "{namespace}*", "/{name}"),
)
_RAW_EXPRESSIONS = (*RAW_NAMES, "raw*", "raw/*", "raw?x", "raw/x*")
_MEETING_EXPRESSIONS = ("rt/x", "rt/*", "*", "rq/*", "rt/x*", "rr/xReply", "*Request", "raw")
_PERMISSIONS = {kind: [permission for of_kind, permission in REQUESTS if of_kind == kind] for kind, _ in REQUESTS} | {
    "topic": ["publish", "subscribe"]
}


def policy(subject: str, rules: Sequence[str]) -> str:
    """Return a policy with one profile for a subject."""
    attachment = f"<attachment>{subject}</attachment>"
    return f'<profiles><profile name="test">{attachment}{"".join(rules)}</profile></profiles>'


def rule(
    effect: str,
    kind: str,
    permissions: Sequence[str],
    expressions: Sequence[str],
    partitions: Sequence[str] = (),
) -> str:
    """Return a rule."""
    attachments = "".join(f"<attachment>{escape(expression)}</attachment>" for expression in expressions)
    held = "".join(f"<{permission}/>" for permission in permissions)
    listed = "".join(f"<partition>{partition}</partition>" for partition in partitions)
    narrowed = f"<partitions>{listed}</partitions>" if partitions else ""
    return (
        f'<{kind} qualifier="{effect}"><attachments>{attachments}</attachments>{narrowed}'
        f"<permissions>{held}</permissions></{kind}>"
    )


def _some(values: Sequence[str], most: int) -> st.SearchStrategy[list[str]]:
    return st.lists(st.sampled_from(values), min_size=1, max_size=most, unique=True)


def _rules(
    kind: str, expressions: Sequence[str], partitions: Sequence[Sequence[str]] = ((),)
) -> st.SearchStrategy[str]:
    return st.builds(
        rule,
        st.sampled_from(["ALLOW", "ALLOW", "DENY"]),
        st.just(kind),
        _some(_PERMISSIONS[kind], 2),
        _some(expressions, 3),
        st.sampled_from(partitions),
    )


_ros = st.sampled_from(sorted({kind for kind, _ in REQUESTS})).flatmap(lambda kind: _rules(kind, _EXPRESSIONS))

separate_rules = st.lists(st.one_of(_ros, _ros, _rules("topic", _RAW_EXPRESSIONS)), max_size=5)
"""Rules on ROS names, and on raw topics that no ROS name maps to."""

meeting_rules = st.lists(st.one_of(_ros, _rules("topic", _MEETING_EXPRESSIONS)), max_size=4)
"""Rules on ROS names, and on the DDS topics that they map to."""

partitioned_rules = st.lists(_rules("topic", (*RAW_NAMES, "raw/*"), [(), ("p",), ("",), ("p", "q")]), max_size=4)
"""Rules on raw topics in partitions."""
