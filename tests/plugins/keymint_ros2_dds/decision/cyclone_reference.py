# SPDX-License-Identifier: Apache-2.0
"""A second reading of Cyclone DDS's ``ac_fnmatch`` that shares no code with Keymint: the tests' oracle."""

from __future__ import annotations

import re

NEVER = "(?!)"


def cyclone_regex(pattern: str) -> str:
    """Return a regular expression for a pattern.

    There is no escape, only ``!`` negates, and the bracket that ends a set is a member of it, so that it begins a range
    where ``-`` follows.
    """
    out: list[str] = []
    at = 0
    while at < len(pattern):
        char = pattern[at]
        at += 1
        if char == "[":
            bracket = _set(pattern, at)
            if bracket is None:
                return NEVER
            piece, at = bracket
            out.append(piece)
        else:
            out.append(".*" if char == "*" else "." if char == "?" else re.escape(char))
    return "".join(out)


def _set(pattern: str, at: int) -> tuple[str, int] | None:
    """Return a set and the index after it; None for one that never matches."""
    negated = pattern.startswith("!", at)
    at += negated
    if pattern.startswith("]", at):  # a set without members; its bracket is then read a second time, as itself
        return (".", at) if negated else None
    ranges = ""
    ended = False
    while not ended:
        if at >= len(pattern):
            return None
        first = last = pattern[at]
        ended = first == "]"
        if pattern.startswith("-", at + 1):
            last = pattern[at + 2 : at + 3]
            if last in {"", "]"}:
                return None
            at += 2
        if first <= last:
            ranges += f"{re.escape(first)}-{re.escape(last)}"
        at += 1
    if not ranges:
        return ("." if negated else NEVER), at
    return f"[{'^' * negated}{ranges}]", at
