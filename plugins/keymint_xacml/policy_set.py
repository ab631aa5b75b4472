# SPDX-License-Identifier: Apache-2.0
r"""Rules as a policy set of XACML 3.0.

What the rules do not decide is denied by the outer set (``deny-unless-permit``). That algorithm alone would let a
permit override a denial, so all policies are in an inner set with ``deny-overrides``. A policy has the rules of one
subject. A rule for composite objects becomes one rule for each part: who asks for such an object asks for all its parts
(:data:`comarmor.rules.PARTS`).

A first policy denies what does not have exactly one value of each attribute: in XACML, one that matches is enough.

Expressions of names become regular expressions of XPath 2.0, which the function ``string-regexp-match`` takes. XACML
3.0, A.3.13 refers to ``xf:matches``: without anchors it looks for a part of the text, and without flags ``.`` matches
no line feed. So they have anchors, and ``[\s\S]`` for any character, which implementations of other dialects (Java,
Python) read alike. Identifiers are of XACML 3.0 (section 10.2 and appendices A to C), or begin with
``urn:keymint:xacml:1.0:``. The document is that of the template ``policy_set.xml.j2``.
"""

from __future__ import annotations

import posixpath
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote as percent_encoded

from comarmor.patterns.glob import literal, parse
from comarmor.patterns.tokens import ANY, COMARMOR, MAX_CODE, Charset, Star, Token
from comarmor.rules import Effect, Rule, parts
from comarmor.text import one_line, quote
from comarmor.values import Data
from keymint.api import ExportedPolicy
from keymint.api.xml_templates import xml_document
from keymint.errors import Diagnostic, KeymintError, Severity, UnsayableError
from keymint.ir import SubjectRules

_XML = Charset(((9, 10), (13, 13), (32, 0xD7FF), (0xE000, 0xFFFD), (0x10000, MAX_CODE)))
"""The characters of XML 1.0 (2.2): a policy and a request have no others."""
_ANY = r"[\s\S]"
_SPECIAL = {ord(char): f"\\{char}" for char in r"\|.-^?*+{}()[]$"} | {9: r"\t", 10: r"\n", 13: r"\r"}
"""Escapes of single characters (XML Schema Part 2, F.1.1; XPath 2.0 Functions, 7.6.1, has the one of ``$``)."""


class TextMatch(Data):
    """How a text is compared.

    Attributes:
        text: the text, or a regular expression with both anchors.
        is_regular: whether it is a regular expression.
    """

    text: str
    is_regular: bool = False


def text_match(expression: str, suffix: str = "") -> TextMatch:
    """Return the comparison that matches the same names, as far as XML can contain them.

    Args:
        expression: an expression of a policy (:data:`comarmor.patterns.tokens.COMARMOR`).
        suffix: follows what it matches.

    Raises:
        UnsayableError: the expression matches no text that XML can contain, or has a character that XML cannot contain.
        PatternError: it is not an expression.
    """
    glob = parse(expression, COMARMOR)
    text = literal(glob)
    if text is None:
        return TextMatch("".join(("^", *map(_token, glob), _token(suffix), "$")), is_regular=True)
    _token(text)
    return TextMatch(text + suffix)


def _token(token: Token) -> str:
    if isinstance(token, Star):
        return f"{_ANY}*"
    if isinstance(token, Charset):
        return _set(token)
    for char in token:
        if char not in _XML:
            raise UnsayableError(f"XML has no character U+{ord(char):04X}")
    return token.translate(_SPECIAL)


def _set(charset: Charset) -> str:
    """Return a set; one that reaches the last character is written by those that are missing."""
    if not charset.intersection(_XML).ranges:
        raise UnsayableError("XML has none of the characters of a set")
    missing = charset.complement().intersection(_XML).ranges
    if charset == ANY or not missing:
        return _ANY
    is_negated = charset.ranges[-1][1] == MAX_CODE
    ranges = missing if is_negated else charset.intersection(_XML).ranges
    ends = [(chr(low).translate(_SPECIAL), chr(high).translate(_SPECIAL)) for low, high in ranges]
    members = "".join(low if low == high else f"{low}-{high}" for low, high in ends)
    return f"[{'^' if is_negated else ''}{members}]"


_XacmlRule = tuple[Rule, str, Mapping[str, Collection[TextMatch]]]
"""The rule that a rule of XACML comes from, with its file and line, and by attribute what any of matches.

The folder is left out, since it differs between machines. It has one kind, without parts. Every partition matches if
there is none.
"""


def written_policy(subjects: Sequence[SubjectRules], *, lossy: bool = False) -> ExportedPolicy:
    """Return the rules as a policy set; see :meth:`keymint.api.PolicyFormat.written`.

    Raises:
        KeymintError: an expression cannot be said; every such rule with its ``file:line``.
    """
    found: list[Diagnostic] = []
    said = [(each.subject, list(_rules(each, found, lossy=lossy))) for each in subjects]
    if any(each.severity is Severity.ERROR for each in found):
        raise KeymintError.of(dict.fromkeys(found))
    return ExportedPolicy(_document(said), tuple(dict.fromkeys(found)))


def _rules(subject: SubjectRules, found: list[Diagnostic], *, lossy: bool) -> Iterator[_XacmlRule]:
    """Yield the rules of a subject, and add what cannot be said."""
    for rule in subject.rules:
        by_part: dict[tuple[str, tuple[str, ...]], dict[TextMatch, None]] = {}
        try:
            for kind, permissions, suffix in _parts(rule):
                matches = by_part.setdefault((kind, permissions), {})
                matches |= dict.fromkeys(text_match(expression, suffix) for expression in rule.expressions)
            partitions = tuple(map(text_match, rule.partitions))
        except UnsayableError as error:
            found.append(_unsayable(rule, str(error), subject.subject, lossy=lossy))
            continue
        if not partitions and rule.effect is Effect.ALLOW:
            partitions = (TextMatch(""),)
        for (kind, permissions), names in by_part.items():
            target = {"kind": [TextMatch(kind)], "action": [*map(TextMatch, permissions)], "name": [*names]}
            origin = f"{one_line(posixpath.basename(rule.origin.file))}:{rule.origin.line}"
            yield rule, origin, {**target, "partition": partitions} if partitions else target


def _parts(rule: Rule) -> Iterator[tuple[str, tuple[str, ...], str]]:
    """Yield kind, permissions and suffix of the parts of a rule; a rule without parts stays one."""
    found = [part for permission in rule.permissions for part in parts(rule.kind, permission)]
    if all(kind == rule.kind for kind, _, _ in found):
        yield rule.kind, rule.permissions, ""
        return
    for kind, permission, suffix in found:
        yield kind, (permission,), suffix


def _unsayable(rule: Rule, reason: str, subject: str, *, lossy: bool) -> Diagnostic:
    message = f"XACML cannot say {rule.effect} {rule.kind} {quote(', '.join(rule.expressions))}: {reason}"
    if lossy and rule.effect is Effect.ALLOW:
        return Diagnostic.warning("xacml-unsayable", message, rule.origin, "left out (--lossy)", subject)
    help_ = "change the expression" + ("; --lossy leaves it out" if rule.effect is Effect.ALLOW else "")
    return Diagnostic.error("xacml-unsayable", message, rule.origin, help_, subject)


def _document(subjects: Iterable[tuple[str, Sequence[_XacmlRule]]]) -> bytes:
    # Without rules the outer set denies everything.
    policies = [(name, percent_encoded(name), [TextMatch(name)], rules) for name, rules in subjects if rules]
    return xml_document(Path(__file__).with_suffix(".xml.j2"), policies=policies)
