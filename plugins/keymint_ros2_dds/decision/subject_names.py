"""Whether a grant is about an identity: subject names as text, the identity's as RFC 2253 has it (last RDN first)."""

from __future__ import annotations

import re

from keymint.errors import KeymintError
from keymint.pki import names

_MAX_PARTS = 20
"""Parts of a name that Cyclone DDS has room for."""


def same_name(grant: str, identity: str) -> bool:
    """Return whether both are the same distinguished name, written from either end (DDS Security 1.1, 9.4.1.3.2.1).

    The specification names no order, and implementations write both.
    """
    text = grant.strip()
    if text == identity:
        return True
    try:
        wanted = list(names.parse_rendered(identity).rdns)
        found = list(names.parse(text).rdns)
    except KeymintError:
        return False
    return found in (wanted, wanted[::-1])


def parts_occur(grant: str, identity: str) -> bool:
    """Cyclone DDS: both names are split at ``,``, ``/`` and ``|``; what the identity has, the grant must have."""
    wanted, found = _parts(identity), _parts(grant)
    return len(wanted) <= _MAX_PARTS and len(found) <= _MAX_PARTS and set(wanted) <= set(found)


def _parts(name: str) -> list[str]:
    return [part for part in re.split(r"[,/|]", name) if part]


def same_text(grant: str, identity: str) -> bool:
    """Fast DDS 2.9: both names are split at ``,`` and compared part by part, blanks around a part aside."""
    return [part.strip(" ") for part in grant.split(",")] == [part.strip(" ") for part in identity.split(",")]
