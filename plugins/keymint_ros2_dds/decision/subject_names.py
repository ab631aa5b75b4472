# SPDX-License-Identifier: Apache-2.0
"""Match the subject name of a grant with that of an identity, as text in the order of RFC 2253 (last RDN first)."""

from __future__ import annotations

import re

from keymint.errors import KeymintError
from keymint.pki import distinguished_names
from keymint_ros2_dds import subject_name_text


def same_name(grant: str, identity: str) -> bool:
    """Compare distinguished names, whose RDNs may be in either order (DDS Security 1.1, 9.4.1.3.2.1).

    The specification does not define the order, and implementations write both.
    """
    text = grant.strip()
    if text == identity:
        return True
    try:
        identity_rdns = list(subject_name_text.parse_rendered(identity).rdns)
        grant_rdns = list(distinguished_names.parse(text).rdns)
    except KeymintError:
        return False
    return grant_rdns in (identity_rdns, identity_rdns[::-1])


def parts_occur(grant: str, identity: str) -> bool:
    """Compare as Cyclone DDS: split at ``,``, ``/`` and ``|``; the grant must have every part of the identity.

    An identity with an empty part before its end has no grant: ``CN=/,OU=4f``, but not ``OU=4f,CN=/``.
    """
    if subject_name_text.has_empty_part(identity):
        return False
    identity_parts, grant_parts = parts(identity), parts(grant)
    most = max(len(identity_parts), len(grant_parts))
    return most <= subject_name_text.MAX_TOKENS and set(identity_parts) <= set(grant_parts)


def trimmed_parts_occur(grant: str, identity: str) -> bool:
    """Compare as Cyclone DDS 11 (``string_to_properties``): as 0.10, without blanks around each part and its ``=``."""
    return parts_occur(_trimmed(grant), _trimmed(identity))


def _trimmed(name: str) -> str:
    return ",".join(_sides_trimmed(part) for part in re.split(r"[,/|]", name))


def _sides_trimmed(part: str) -> str:
    return "=".join(side.strip(" ") for side in part.split("=", 1))


def parts(name: str) -> list[str]:
    """Return the parts of a name that Cyclone DDS compares (``ac_check_subjects_are_equal``)."""
    return [part for part in re.split(r"[,/|]", name) if part]


def same_text(grant: str, identity: str) -> bool:
    """Compare as Fast DDS 2.9: split at ``,``; the parts must be equal, ignoring blanks around them."""
    return [part.strip(" ") for part in grant.split(",")] == [part.strip(" ") for part in identity.split(",")]


def same_attributes(grant: str, identity: str) -> bool:
    """Compare as Fast DDS from 2.11: the attributes in any order; blanks, quotes and backslashes do not count.

    Both have equally many, and for each of the grant's the identity's first one of that type has the same value; an
    identity without one has an empty value (``operator==`` in ``DistinguishedName.cpp``, the same from 2.11.0 to 3.6.2;
    measured on 3.3.0). So ``CN=/a,CN=/a`` applies to ``CN=/a,CN=/b`` and ``CN=/a,OU=x``, and ``CN=/a,CN=/b`` to nobody.
    """
    own, other = _attributes(grant), _attributes(identity)
    first = dict(reversed(other))
    return len(own) == len(other) and all(first.get(kind, "") == value for kind, value in own)


def _attributes(name: str) -> list[tuple[str, str]]:
    """Return the types and values of a name, up to the first part that is no attribute; ``+`` separates as ``,``."""
    found: list[tuple[str, str]] = []
    rest, more = name, True
    while more and len(found) < subject_name_text.MAX_TOKENS:
        kind, rest, is_attribute = _cut(rest, "=")
        if not is_attribute:
            break
        value, rest, more = _cut(rest, ",+")
        found.append((_unquoted(kind), _unquoted(value)))
    return found


def _cut(text: str, marks: str) -> tuple[str, str, bool]:
    """Return what stands before and after the first mark outside of quotes and escapes, and whether there is one."""
    quoted = escaped = False
    for at, char in enumerate(text):
        if char in marks and not quoted and not escaped:
            return text[:at], text[at + 1 :], True
        quoted ^= char == '"' and not escaped
        escaped = char == "\\" and not escaped
    return text, "", False


def _unquoted(text: str) -> str:
    return re.sub(r'["\\]', "", text.strip(" "))


def tokens(name: str) -> frozenset[str]:
    """Return the words of a name, of which the types of its attributes are some."""
    return frozenset(filter(None, re.split(r"[\s,/|=+]+", name)))


def required_tokens(identity: str) -> frozenset[str]:
    """Return the words that each grant for an identity has, unless that is odd, or the identity has a type twice."""
    return tokens(re.sub(r"[^,/|+=]*=", ",", identity))


def is_odd(grant: str) -> bool:
    """Tell whether a grant may apply to names with other words: it is quoted, or has an empty value or a type twice."""
    parts = [_sides_trimmed(part).partition("=") for part in re.split(r"[,+]", grant)]
    kinds = [kind for kind, _, _ in parts]
    return bool(re.search(r'["\\#]', grant)) or not all(value for *_, value in parts) or len({*kinds}) < len(kinds)
