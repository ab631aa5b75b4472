"""Names as they are shown: names come from networks, so nothing in them is trusted to be printable or short."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence

from keymint.graph import Object

KINDS = {
    "ros_topic": "topic",
    "ros_service": "service",
    "ros_action": "action",
    "ros_parameter": "parameters",
    "topic": "DDS topic",
}
"""What a reader calls the kinds of objects, in the order of legends."""

OUTWARD = ("publish", "execute", "operate", "write", "relay")
INWARD = ("subscribe", "call", "request", "read", "relay")
"""Roles by the direction in which their edge is drawn: what a subject offers goes out, what it takes comes in."""

_UNPRINTABLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
_LONGEST = 44
_WORD = re.compile(r"[^/_ ]*[/_ ]|[^/_ ]+\Z", re.DOTALL)
"""A word with what parts it from the next."""


def role(permission: str) -> str:
    """Return a permission without the prefix of ROS: ``publish`` of ``ros_publish``."""
    return permission.removeprefix("ros_")


def printable(text: str) -> str:
    r"""Return text in which what cannot be seen, or reorders what is seen (bidirectional controls), is ``\uXXXX``."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        char if unicodedata.category(char) not in _UNPRINTABLE else char.encode("unicode_escape", "replace").decode()
        for char in text
    )


def object_name(found: Object, domain: int = 0) -> str:
    """Return an object's name with what tells it from others of that name: ``scan @ a, b (domain 3)``."""
    partitions = f" @ {', '.join(partition or '(empty)' for partition in found.partitions)}" if found.partitions else ""
    return printable(f"{found.name}{partitions}" + (f" (domain {domain})" if domain else ""))


def shorten(text: str, longest: int = _LONGEST) -> str:
    """Return text that is not longer than that many characters; the middle gives way, as ends tell names apart.

    Words stay whole where one at least fits: the text is cut behind ``/``, ``_`` or a blank.
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
    """Return the first words that have no more characters together."""
    found: list[str] = []
    for word in words:
        room -= len(word)
        if room < 0:
            break
        found.append(word)
    return found


def columns(text: str) -> int:
    """Return how many columns of a fixed-width font a text takes (Unicode Standard Annex 11)."""
    wide = sum(unicodedata.east_asian_width(char) in "WF" for char in text) if not text.isascii() else 0
    return len(text) + wide
