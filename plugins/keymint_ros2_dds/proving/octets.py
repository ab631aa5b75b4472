# SPDX-License-Identifier: Apache-2.0
"""The names that claims cover: all DDS names, as bytes.

A DDS name is a C string: bytes other than NUL. In the C locale vendors compare bytes, and so do claims: each byte is
one character here, an expression is its UTF-8 bytes, and ``?`` and a set match one byte.

Fast DDS uses the locale of its process. In a UTF-8 locale ``fnmatch`` of glibc lets ``?`` and a set match one byte or
one character. For ASCII names that is the same, so claims about them hold in every locale; for others the C locale is
an assumption. Nothing is claimed where an expression itself depends on the locale: a set with characters beyond ASCII,
a class such as ``[:alpha:]``, or characters beyond ASCII together with ``?`` and sets elsewhere. The compiler writes
none of these. A class in a policy is that of the C locale.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache

from comarmor.patterns.decision_lists import Universe
from comarmor.patterns.glob import Glob, normalise, parse
from comarmor.patterns.tokens import Dialect, charset
from comarmor.text import lazy_regex
from comarmor.values import replace
from keymint.ir import Rule, SubjectRules
from keymint_ros2_dds.decision.semantics import STANDARD, Semantics
from keymint_ros2_dds.reading import dialects
from keymint_ros2_dds.reading.signed_permissions import DocumentCriteria, DocumentGrant, PermissionsDocument

ALPHABET = charset([(0x01, 0xFF)])
"""The bytes of a name."""
SEPARATOR = "\0"
"""What stands between a partition and a topic in a word."""
TOPICS = (
    "every topic name of one or more bytes other than NUL (text is its bytes in UTF-8), in the default partition; "
    "nothing is permitted outside of it"
)
PAIRS = (
    "every pair of a partition and a topic name, of bytes other than NUL (text is its bytes in UTF-8); a topic name "
    "has one or more"
)
_MANY = frozenset("?[")
"""What stands for one character, or one byte."""
_DEPENDS = "depends on the locale"
_CLASS = lazy_regex(r"\[:(?!x?digit:\])")
"""A class that may have characters beyond ASCII."""


def universe(*, pairs: bool) -> Universe:
    """Return the names that claims cover: topics, or a partition and a topic."""
    return Universe(ALPHABET, fields=2 if pairs else 1, separator=SEPARATOR, last_nonempty=True)


def pair(partition: Glob, topic: Glob) -> Glob:
    """Return a pattern of a partition and a topic."""
    return normalise((*partition, SEPARATOR, *topic))


def of_glob(glob: Glob) -> Glob:
    """Return a pattern over bytes: its literals as UTF-8."""
    if all(token.isascii() for token in glob if isinstance(token, str)):
        return glob
    return tuple(dialects.in_bytes(token) if isinstance(token, str) else token for token in glob)


# Each model asks for each list of expressions, and for some of them in both directions.
@lru_cache(maxsize=64)
def read(expressions: tuple[str, ...], dialect: Dialect) -> tuple[Glob, ...]:
    """Return the distinct patterns of the expressions of a document, over bytes, as a dialect has them.

    Raises:
        PatternError: an expression contains notation that implementations read differently.
    """
    joined = "".join(expressions)
    if dialects.is_plain(joined):
        if not joined.isascii():
            expressions = tuple(map(dialects.in_bytes, expressions))
        return tuple((text,) if text else () for text in dict.fromkeys(expressions))
    strict = replace(dialect, errors=frozenset({"unknown class", "collation"}))
    patterns = dict.fromkeys([parse(expression, strict) for expression in expressions])
    return tuple(patterns) if joined.isascii() else tuple(dict.fromkeys(map(of_glob, patterns)))


def in_text(name: str) -> str:
    """Return a name of bytes as text; invalid UTF-8 becomes surrogates (PEP 383)."""
    return name if name.isascii() else name.encode("latin-1").decode("utf-8", "surrogateescape")


def is_independent(document: PermissionsDocument, rules: SubjectRules) -> bool:
    """Return whether no expression depends on the locale, however it is read: see :func:`locale_dependence`."""
    policy = (text for rule in rules.rules for text in (*rule.expressions, *rule.partitions))
    joined = "".join((*policy, *(text for text, _ in _expressions(document.grants, STANDARD))))
    return joined.isascii() and not ("[:" in joined and _CLASS.search(joined))


def locale_dependence(
    document: PermissionsDocument, grants: Iterable[DocumentGrant], rules: SubjectRules, semantics: Semantics
) -> tuple[str, str]:
    """Return which expression depends on the locale, as two texts; each is empty if there is none.

    The first names an expression that cannot be read as bytes, because it has a set with members beyond ASCII. The
    second names one because of which a claim that is proven over bytes is not made.

    Args:
        document: the permissions document.
        grants: the grants that apply.
        rules: the policy's rules for the subject.
        semantics: how the document is read.
    """
    own = tuple(_expressions(grants, semantics))
    policy = ((text, rule) for rule in rules.rules for text in (*rule.expressions, *rule.partitions))
    expressions: tuple[tuple[str, DocumentCriteria | Rule], ...] = (*own, *policy)

    def cited(expression: str, source: DocumentCriteria | Rule) -> str:
        place = source.origin if isinstance(source, Rule) else document.place(source.line)
        return f"{place}: {expression!r} has"

    wide = [(expression, source) for expression, source in expressions if not expression.isascii()]
    sets = (
        f"{cited(expression, source)} a set and characters beyond ASCII: what it matches {_DEPENDS}"
        for expression, source in wide
        if "[" in expression
    )
    unread = next(sets, "")
    if semantics.fnmatch is not dialects.CYCLONE_DDS:
        for expression, source in own:
            if _CLASS.search(expression):
                return unread, f"{cited(expression, source)} a class of characters: what it matches {_DEPENDS}"
    if wide and not all(_MANY.isdisjoint(expression) for expression, _ in expressions):
        reason = "characters beyond ASCII: whether '?' and sets elsewhere match them by byte or by character"
        return unread, f"{cited(*wide[0])} {reason} {_DEPENDS}"
    return unread, ""


def _expressions(grants: Iterable[DocumentGrant], semantics: Semantics) -> Iterator[tuple[str, DocumentCriteria]]:
    """Yield the expressions of grants, each with its criteria."""
    for grant in grants:
        for rule in grant.rules:
            for criteria in rule.criteria:
                if criteria.action != "relay":
                    for text in (*criteria.topics, *(criteria.partitions or ())):
                        yield semantics.reads_text(text), criteria
