# SPDX-License-Identifier: Apache-2.0
"""Names and labels as display text: names come from networks and may be unprintable or long."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence

from comarmor.regex import lazy_regex
from comarmor.text import printable
from keymint.api.graph import EdgeOutcome, Object
from keymint.drawing.labelled_graph import Label, LabelledEdge

KINDS = {
    "ros_topic": "topic",
    "ros_service": "service",
    "ros_action": "action",
    "ros_parameter": "parameters",
    "topic": "raw topic",
}
"""Display names of the kinds of objects, in the order of legends."""

OUTWARD = ("publish", "execute", "operate", "write", "relay")
INWARD = ("subscribe", "call", "request", "read", "relay")
"""Roles by direction of their edge: from the subject to the object, or back."""

OUTCOMES = {
    EdgeOutcome.FALSE_POSITIVE: "DANGER: allowed, but the policy denies it (false positive)",
    EdgeOutcome.FALSE_NEGATIVE: "denied, but the policy allows it (false negative)",
    EdgeOutcome.ALLOW: "allowed",
    EdgeOutcome.DENY: "denied",
    EdgeOutcome.UNLABELLED: "no decision",
}
"""What is decided about an edge, in the order of pages."""

_LONGEST = 44
_WORD = lazy_regex(r"[^/_ ]*[/_ ]|[^/_ ]+\Z", re.DOTALL)
"""A word with the separator after it."""


def role(permission: str) -> str:
    """Return a permission without its ROS prefix: ``publish`` of ``ros_publish``."""
    return permission.removeprefix("ros_")


def directions(permission: str) -> tuple[bool, bool]:
    """Return whether data flow from the subject to the object, and whether they flow back."""
    return role(permission) in OUTWARD, role(permission) in INWARD


def object_name(object_: Object, domain: int = 0) -> str:
    """Return an object's name with its partitions and domain: ``scan @ a, b (domain 3)``."""
    partitions = ", ".join(partition or "(empty)" for partition in object_.partitions)
    suffix = (f" @ {partitions}" if partitions else "") + (f" (domain {domain})" if domain else "")
    return printable(object_.name + suffix)


def shorten(text: str, longest: int = _LONGEST) -> str:
    """Return text with its middle replaced by ``…`` if it has more than ``longest`` characters.

    Cuts after ``/``, ``_`` or a space if at least one word fits.
    """
    if len(text) <= longest:
        return text
    head = (longest - 1) // 3
    words = _WORD.findall(text)
    end = _fitting(reversed(words), longest - 1 - head)
    if not end:
        return f"{text[:head]}…{text[len(text) - (longest - 1 - head) :]}"
    begin = _fitting(words, longest - 1 - sum(map(len, end)))
    return f"{''.join(begin)}…{''.join(reversed(end))}"


def _fitting(words: Iterable[str], room: int) -> Sequence[str]:
    """Return the first words that together have at most ``room`` characters."""
    fitting: list[str] = []
    for word in words:
        room -= len(word)
        if room < 0:
            break
        fitting.append(word)
    return fitting


def columns(text: str) -> int:
    """Return the width of a text in columns of a fixed-width font (Unicode Standard Annex 11)."""
    wide = sum(unicodedata.east_asian_width(char) in "WF" for char in text) if not text.isascii() else 0
    return len(text) + wide


def sentence(labelled: LabelledEdge, transports: Sequence[str]) -> str:
    """Return an edge with all its labels on one line."""
    edge = labelled.edge
    layers = [("policy", labelled.policy), *zip(transports, labelled.transports, strict=True)]
    labels = "; ".join(f"{name}: {_label_text(label)}" for name, label in layers if label is not None)
    text = f"{edge.subject} {edge.permission} {object_name(edge.object, edge.domain)}"
    return printable(text + (f" - {labels}" if labels else "") + (" (AUDIT)" if labelled.audit else ""))


def _label_text(label: Label) -> str:
    because = ": ".join(filter(None, (str(label.where) if label.where else "", label.reason)))
    return ("allowed" if label.allowed else "denied") + (f" ({because})" if because else "")
