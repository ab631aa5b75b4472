# SPDX-License-Identifier: Apache-2.0
"""Subject names in permissions documents: distinguished names as DDS vendors write and compare them.

The text of ``<subject_name>`` is in the order of RFC 2253, last RDN first: the other way round than in a certificate
and in :mod:`keymint.pki.distinguished_names`.
"""

from __future__ import annotations

import re
from itertools import takewhile

from cryptography import x509

from comarmor.text import lazy_regex
from keymint.api import Grant
from keymint.errors import KeymintError, Origin
from keymint.pki import distinguished_names

MAX_TOKENS = 20
"""Maximum tokens, split at ``,`` ``/`` and ``|``, of the subject name of a grant; Cyclone DDS ignores one with more."""
_AMBIGUOUS = frozenset('"\\<>;|')
"""Characters that some vendor escapes or treats as a separator when it compares names."""
_USUAL = lazy_regex(r"(?:(OU=[\w.-]{1,64}),)?(CN=(?=.{1,64}\Z)/?[\w.-]+(?:/[\w.-]+){0,15})", re.ASCII)
"""A name whose text is known without parsing it, and which every vendor reads and compares as it is."""
_ESCAPED = lazy_regex(r"^#|[,+]")


def subject_name_of(grant: Grant) -> str:
    """Return the text of ``<subject_name>`` of a grant.

    Raises:
        KeymintError: the name is invalid, or contains something that vendors read differently.
    """
    if usual := _USUAL.fullmatch(grant.subject_name):
        return _reversed(usual)
    return render(distinguished_names.parse(grant.subject_name, grant.origin))


def _reversed(usual: re.Match[str]) -> str:
    return f"{usual[2]},{usual[1]}" if usual[1] else usual[2]


def is_usual(name: str) -> bool:
    """Tell whether every vendor finds a grant by a name and reads it as it is; of a name that is not, it may."""
    return _USUAL.fullmatch(name) is not None


def render(name: x509.Name, where: Origin | None = None) -> str:
    """Return the text of ``<subject_name>``.

    This is how OpenSSL prints the certificate's subject with ``XN_FLAG_RFC2253``, last RDN first: Fast DDS 2.9 compares
    exactly this text, Cyclone DDS accepts the RDNs in any order (DDS Security 1.1, 9.4.1.3.2.1, leaves the
    comparison to the vendor). A certificate with ``OU=x1,CN=/robot`` is ``CN=/robot,OU=x1`` here.

    Raises:
        KeymintError: the name contains something that vendors read differently.
    """
    if usual := _USUAL.fullmatch(distinguished_names.to_text(name)):
        return _reversed(usual)
    attributes = list(distinguished_names.attributes(name))
    for kind, value in attributes:
        if kind[0].isdigit():
            raise _not_portable(f"has the attribute {kind}", where)
        if not value.isascii():
            raise _not_portable(f"has characters beyond ASCII in {kind}={value!r}", where)
        if odd := sorted(_AMBIGUOUS.intersection(value)):
            raise _not_portable(f"has {' and '.join(map(repr, odd))} in {kind}={value!r}", where)
        if value != " ".join(value.split()):
            raise _not_portable(f"has leading, trailing or repeated spaces in {kind}={value!r}", where)
    # In a name without the characters refused above, OpenSSL escapes only these.
    escaped = ((kind, _ESCAPED.sub(r"\\\g<0>", value)) for kind, value in reversed(attributes))
    shown = ",".join(f"{kind}={value}" for kind, value in escaped)
    tokens = sum(1 for token in re.split(r"[,/]", shown) if token)
    if has_empty_part(shown):
        why = "nothing stands between two of its separators ',' and '/'"
        message = f"Cyclone DDS refuses the subject name {shown}: {why}"
        help_ = "put a CN that ends with '/' first in the certificate: CN=/,OU=x1, which is OU=x1,CN=/ in the grant"
        raise KeymintError(message, where=where, help=help_, code="portability-subject-name")
    if tokens > MAX_TOKENS:
        problem = f"has {tokens} parts between ',' and '/', the maximum is {MAX_TOKENS}: {shown[:60]}…"
        raise _not_portable(problem, where)
    return shown


def of_any(name: x509.Name) -> str:
    """Return the text of ``<subject_name>``; a name that vendors compare differently as it is.

    ``keymint check`` reports such a name.
    """
    try:
        return render(name)
    except KeymintError:
        return name.rfc4514_string()


def twice(name: x509.Name) -> str:
    """Return what vendors make of a name that has an attribute twice, or an empty text for any other name.

    Fast DDS compares the first one of a type in the order of RFC 2253 (``keymint_ros2_dds.subject_names``).
    """
    kinds = [kind for kind, _ in distinguished_names.attributes(name)]
    doubled = next((kind for kind in kinds if kinds.count(kind) > 1), "")
    shown = distinguished_names.to_text(name)
    return doubled and (
        f"has {doubled} twice in its name {shown!r}: Fast DDS from 2.11 on confuses it with names that have "
        f"one {doubled} twice, and may refuse its own permissions"
    )


def has_empty_part(text: str) -> bool:
    """Tell whether a name has an empty part before its end, between ``,``, ``/`` and ``|``.

    Cyclone DDS 0.10.2 finds no grant for such an identity ("Subject name is invalid").
    """
    return "" in _split(text)[:-1]


def parse_rendered(text: str) -> x509.Name:
    """Parse a ``<subject_name>``: the inverse of :func:`render`.

    Raises:
        KeymintError: the text is not a name.
    """
    return x509.Name(reversed(list(distinguished_names.parse(text))))


def _not_portable(problem: str, where: Origin | None) -> KeymintError:
    message = f"the subject name {problem}, which DDS vendors compare differently"
    help_ = "use letters, digits and '/', '_', '-', '.', '@', e.g. CN=/robot/camera,OU=x1"
    return KeymintError(message, where=where, help=help_, code="portability-subject-name")


def same_name(grant: str, identity: str) -> bool:
    """Compare distinguished names, whose RDNs may be in either order (DDS Security 1.1, 9.4.1.3.2.1).

    The specification does not define the order, and implementations write both.
    """
    text = grant.strip()
    if text == identity:
        return True
    try:
        identity_rdns = list(parse_rendered(identity).rdns)
        grant_rdns = list(distinguished_names.parse(text).rdns)
    except KeymintError:
        return False
    return grant_rdns in (identity_rdns, identity_rdns[::-1])


def parts_occur(grant: str, identity: str) -> bool:
    """Compare as Cyclone DDS: split at ``,``, ``/`` and ``|``; the grant must have every part of the identity.

    Of parts of the grant with one type, the first counts: ``OU=0,OU=4f`` lacks ``OU=4f``. A grant of more than
    :data:`MAX_TOKENS` parts is for nobody; an identity may have any number. An identity with an empty part before its
    end has no grant: ``CN=/,OU=4f``, but not ``OU=4f,CN=/``.
    """
    if has_empty_part(identity):
        return False
    own, others = ([part.partition("=")[::2] for part in parts(name)] for name in (identity, grant))
    first = dict(reversed(others))
    return len(others) <= MAX_TOKENS and all(first.get(kind) == value for kind, value in own)


def trimmed_parts_occur(grant: str, identity: str) -> bool:
    """Compare as Cyclone DDS 11 (``string_to_properties``): as 0.10, without blanks around each part and its ``=``."""
    return parts_occur(_trimmed(grant), _trimmed(identity))


def _trimmed(name: str) -> str:
    return ",".join(_sides_trimmed(part) for part in _split(name))


def _sides_trimmed(part: str) -> str:
    return "=".join(side.strip(" ") for side in part.split("=", 1))


def parts(name: str) -> list[str]:
    """Return the parts of a name that Cyclone DDS compares (``ac_check_subjects_are_equal``)."""
    return [part for part in _split(name) if part]


def _split(name: str) -> list[str]:
    return name.replace("/", ",").replace("|", ",").split(",")


def same_text(grant: str, identity: str) -> bool:
    """Compare as Fast DDS 2.9: split at ``,``; the parts before the first empty one are equal, but for blanks around.

    So ``CN=/a,,OU=x`` is for ``CN=/a`` (``rfc2253_string_compare`` in ``Permissions.cpp``; measured on 2.9.1).
    """
    own, other = ([part.strip(" ") for part in takewhile(bool, name.split(","))] for name in (identity, grant))
    return own == other


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
    """Return the types and values of a name, up to the first part that is no attribute.

    As in ``find_and_add_type_values``, what is empty before a separator is all that follows: ``OU=,CN=/a`` has the
    value ``,CN=/a`` for ``OU``.
    """
    found: list[tuple[str, str]] = []
    rest, more = name, True
    while more and len(found) < MAX_TOKENS:
        kind, after, is_attribute = _cut(rest.lstrip(" "), "=")
        if not is_attribute:
            break
        value, following, more = _cut(after, ",")
        found.append((_unquoted(kind or rest), _unquoted(value or after)))
        rest = following
    return found


def _cut(text: str, mark: str) -> tuple[str, str, bool]:
    """Return what stands before and after the first mark outside of quotes and escapes, and whether there is one."""
    quoted = escaped = False
    for at, char in enumerate(text):
        if char == mark and not quoted and not escaped:
            return text[:at], text[at + 1 :], True
        quoted ^= char == '"' and not escaped
        escaped = char == "\\" and not escaped
    return text, "", False


def _unquoted(text: str) -> str:
    return text.strip(" ").replace('"', "").replace("\\", "")


def tokens(name: str) -> frozenset[str]:
    """Return the words of a name, of which the types of its attributes are some."""
    return frozenset(filter(None, re.split(r"[\s,/|=+]+", name)))


def required_tokens(identity: str) -> frozenset[str]:
    """Return the words that each grant for an identity has, unless that is odd, or the identity has a type twice."""
    return tokens(re.sub(r'["\\]', "", re.sub(r"[^,/|+=]*=", ",", identity)))


def is_odd(grant: str) -> bool:
    """Tell whether a grant may apply to names with other words: it is quoted, or has an empty value or a type twice."""
    parts = [_sides_trimmed(part).partition("=") for part in re.split(r"[,+]", grant)]
    kinds = [kind for kind, _, _ in parts]
    return bool(re.search(r'["\\#]', grant)) or not all(value for *_, value in parts) or len({*kinds}) < len(kinds)
