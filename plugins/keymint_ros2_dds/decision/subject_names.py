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
    identity_parts, grant_parts = _parts(identity), _parts(grant)
    most = max(len(identity_parts), len(grant_parts))
    return most <= subject_name_text.MAX_TOKENS and set(identity_parts) <= set(grant_parts)


def trimmed_parts_occur(grant: str, identity: str) -> bool:
    """Compare as Cyclone DDS 11 (``string_to_properties``): as 0.10, without blanks around each part and its ``=``."""
    return parts_occur(_trimmed(grant), _trimmed(identity))


def _trimmed(name: str) -> str:
    return ",".join(_sides_trimmed(part) for part in re.split(r"[,/|]", name))


def _sides_trimmed(part: str) -> str:
    return "=".join(side.strip(" ") for side in part.split("=", 1))


def _parts(name: str) -> list[str]:
    return [part for part in re.split(r"[,/|]", name) if part]


def same_text(grant: str, identity: str) -> bool:
    """Compare as Fast DDS 2.9: split at ``,``; the parts must be equal, ignoring blanks around them."""
    return [part.strip(" ") for part in grant.split(",")] == [part.strip(" ") for part in identity.split(",")]


def same_attributes(grant: str, identity: str) -> bool:
    """Compare as Fast DDS from 2.11: the attributes in any order; blanks, quotes and backslashes do not count.

    Both have equally many, and the identity has each of the grant's (``operator==`` in its ``DistinguishedName.cpp``,
    the same from 2.11.0 to 3.6.2; measured on 3.3.0). So ``CN=/a,CN=/a`` applies to ``CN=/a,CN=/b``, not the reverse.
    """
    own, other = _attributes(grant), _attributes(identity)
    return len(own) == len(other) and set(own) <= set(other)


def _attributes(name: str) -> list[str]:
    """Return the attributes of a name, each as ``TYPE=VALUE``; a ``+`` separates them as a ``,`` does."""
    parts = re.split(r"(?<!\\)[,+]", name)
    return [_sides_trimmed(re.sub(r'["\\]', "", part)) for part in parts]


def tokens(name: str) -> frozenset[str]:
    """Return the words of a name. An identity matches a grant only if the grant's name has all words of the identity's.

    That holds for every comparison in this module, unless the identity has two attributes of a type.
    """
    return frozenset(filter(None, re.split(r"""[\s,/|=+"\\]+""", name)))
