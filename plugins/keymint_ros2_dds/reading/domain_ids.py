"""Domain ids as Cyclone DDS reads them: as ``strtoll`` of C does, and of the result 32 bits."""

from __future__ import annotations

import re

REFUSED = -1
"""Stands for a number that Cyclone DDS refuses."""
_PLAIN = re.compile(r"0|[1-9][0-9]{0,8}")
_OCTAL = re.compile(r"[+-]?0[0-7]*")
_DECIMAL = re.compile(r"[+-]?[1-9][0-9]*")
_BLANKS = " \t\v\r\n"


def is_odd(text: str) -> bool:
    """Tell whether a number may be another one in C: for a zero before it, or for its size."""
    return _PLAIN.fullmatch(text.strip(_BLANKS)) is None


def in_c(text: str) -> int:
    """Return a whole number as C reads it, or :data:`REFUSED`.

    Args:
        text: a sign or none, and digits, white space around it aside.
    """
    plain = text.strip(_BLANKS)
    if _OCTAL.fullmatch(plain):
        found = int(plain, 8)
    elif _DECIMAL.fullmatch(plain):
        found = int(plain)
    else:
        return REFUSED
    if not -(2**63) <= found < 2**63:
        return REFUSED
    found &= 0xFFFFFFFF
    return found if found < 2**31 else REFUSED
