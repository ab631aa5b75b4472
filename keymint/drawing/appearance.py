# SPDX-License-Identifier: Apache-2.0
"""How graphs look: names and labels as text, colours and line styles for light and dark backgrounds as a style sheet.

Names come from networks and may be unprintable or long.

Nothing depends on colour alone: arrowheads of denied edges are hollow and barred, false labels are solid and heavy,
false positives have a hazard band and a warning sign, and the legend names every kind of object. The contrast to the
background is at least 4.5 to 1 for text and 3 to 1 for lines (WCAG 2.2, 1.4.3 and 1.4.11).
"""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Sequence
from enum import StrEnum
from importlib import resources
from itertools import accumulate

from comarmor.text import lazy_regex, one_line
from keymint.api.graph import EdgeOutcome, Object
from keymint.drawing.labelled_graph import LabelledEdge

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
    EdgeOutcome.UNLABELLED: "without a decision",
}
"""What is decided about an edge, in the order of pages."""

SIGNS = dict(zip((*OUTWARD[:4], *INWARD[:4], "relay"), "PEOWSCQRB", strict=True))
"""Letters of roles in a matrix; Q is for requests, B for both ways."""

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
    return one_line(object_.name + suffix)


def shorten(text: str, longest: int = _LONGEST) -> str:
    """Return text with its middle replaced by ``…`` if it has more than ``longest`` characters.

    Cuts after ``/``, ``_`` or a space if at least one word fits.
    """
    if len(text) <= longest:
        return text
    head = (longest - 1) // 3
    words = _WORD.findall(text)
    end = _fitting(words[::-1], longest - 1 - head)
    if not end:
        return f"{text[:head]}…{text[len(text) - (longest - 1 - head) :]}"
    begin = _fitting(words, longest - 1 - sum(map(len, end)))
    return f"{''.join(begin)}…{''.join(reversed(end))}"


def _fitting(words: Sequence[str], room: int) -> Sequence[str]:
    """Return the first words that together have at most ``room`` characters."""
    return [word for word, end in zip(words, accumulate(map(len, words)), strict=True) if end <= room]


def columns(text: str) -> int:
    """Return the width of a text in columns of a fixed-width font (Unicode Standard Annex 11)."""
    wide = sum(unicodedata.east_asian_width(char) in "WF" for char in text) if not text.isascii() else 0
    return len(text) + wide


def sentence(labelled: LabelledEdge, transports: Sequence[str]) -> str:
    """Return an edge with all its labels on one line."""
    edge = labelled.edge
    layers = [("policy", labelled.policy), *zip(transports, labelled.transports, strict=True)]
    labels = []
    for name, label in layers:
        if label is not None:
            because = ": ".join(filter(None, (str(label.where) if label.where else "", label.reason)))
            labels.append(f"{name}: {'allowed' if label.allowed else 'denied'}" + (f" ({because})" if because else ""))
    text = f"{edge.subject} {edge.permission} {object_name(edge.object, edge.domain)}"
    return one_line(text + (f" - {'; '.join(labels)}" if labels else "") + (" (AUDIT)" if labelled.audit else ""))


class Theme(StrEnum):
    """Background of a picture; ``auto`` follows the browser's preference and is light elsewhere."""

    AUTO = "auto"
    LIGHT = "light"
    DARK = "dark"


_COLOURS = resources.files(__package__).joinpath("templates", "colours.toml").read_text(encoding="utf-8")
LIGHT, DARK = tomllib.loads(_COLOURS).values()
KIND_NAMES = ("subject", *KINDS)

FONTS = "'DejaVu Sans Mono','Liberation Mono',Menlo,Consolas,'Noto Sans Mono',monospace"
"""Fixed-width fonts of 0.55 to 0.61 em, for which boxes are sized."""


def edge_classes(outcome: EdgeOutcome, *, labels: bool) -> str:
    """Return the style sheet classes of an edge; with ``labels`` of transports also ``true`` or ``false``."""
    if outcome is EdgeOutcome.UNLABELLED:
        return "plain"
    if outcome is EdgeOutcome.FALSE_POSITIVE:
        return "danger false"
    verdict = "allow" if outcome.allowed else "deny"
    return f"{verdict} {'false' if outcome.false else 'true'}" if labels else verdict
