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
Python) read alike. Identifiers are of XACML 3.0 (section 10.2 and appendices A to C), or begin with :data:`OWN`.
"""

from __future__ import annotations

import posixpath
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from urllib.parse import quote as percent_encoded

from lxml import etree

from comarmor.errors import Diagnostic, Severity
from comarmor.patterns.glob import literal, parse
from comarmor.patterns.tokens import ANY, COMARMOR, MAX_CODE, Charset, Star, Token
from comarmor.rules import Effect, Rule, parts
from comarmor.text import one_line, quote
from comarmor.values import dataclass
from keymint.api import ExportedPolicy
from keymint.errors import KeymintError, UnsayableError
from keymint.ir import SubjectRules

NAMESPACE = "urn:oasis:names:tc:xacml:3.0:core:schema:wd-17"
STRING = "http://www.w3.org/2001/XMLSchema#string"
INTEGER = "http://www.w3.org/2001/XMLSchema#integer"

DENY_UNLESS_PERMIT = "urn:oasis:names:tc:xacml:3.0:policy-combining-algorithm:deny-unless-permit"
POLICIES_DENY_OVERRIDES = "urn:oasis:names:tc:xacml:3.0:policy-combining-algorithm:deny-overrides"
RULES_DENY_OVERRIDES = "urn:oasis:names:tc:xacml:3.0:rule-combining-algorithm:deny-overrides"

_FUNCTION = "urn:oasis:names:tc:xacml:1.0:function:"
STRING_EQUAL = f"{_FUNCTION}string-equal"
REGULAR_MATCH = f"{_FUNCTION}string-regexp-match"
NOT, AND = f"{_FUNCTION}not", f"{_FUNCTION}and"
INTEGER_EQUAL, BAG_SIZE = f"{_FUNCTION}integer-equal", f"{_FUNCTION}string-bag-size"

OWN = "urn:keymint:xacml:1.0:"
"""Begins the identifiers that are not of the standard."""
AUDIT, ORIGIN = f"{OWN}advice:audit", f"{OWN}advice:origin"
_RESOURCE = "urn:oasis:names:tc:xacml:3.0:attribute-category:resource"


Attribute = tuple[str, str]
"""The category and the identifier of an attribute of a request, a string."""
SUBJECT = (
    "urn:oasis:names:tc:xacml:1.0:subject-category:access-subject",
    "urn:oasis:names:tc:xacml:1.0:subject:subject-id",
)
NAME = (_RESOURCE, "urn:oasis:names:tc:xacml:1.0:resource:resource-id")
ACTION = ("urn:oasis:names:tc:xacml:3.0:attribute-category:action", "urn:oasis:names:tc:xacml:1.0:action:action-id")
KIND = (_RESOURCE, f"{OWN}resource:kind")
PARTITION = (_RESOURCE, f"{OWN}resource:partition")
ATTRIBUTES = (SUBJECT, NAME, KIND, PARTITION, ACTION)
"""What a request has, each with one value; the partition is empty for the default one."""


_XML = Charset(((9, 10), (13, 13), (32, 0xD7FF), (0xE000, 0xFFFD), (0x10000, MAX_CODE)))
"""The characters of XML 1.0 (2.2): a policy and a request have no others."""
_ANY = r"[\s\S]"
_SPECIAL = {ord(char): f"\\{char}" for char in r"\|.-^?*+{}()[]$"} | {9: r"\t", 10: r"\n", 13: r"\r"}
"""Escapes of single characters (XML Schema Part 2, F.1.1; XPath 2.0 Functions, 7.6.1, has the one of ``$``)."""


@dataclass(frozen=True, slots=True)
class TextMatch:
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


_DESCRIPTION = (
    "Ask with one value of each attribute; that of the partition is empty for the default one. An object that has "
    "parts, as an action, is permitted if all of them are: ask for each."
)
_EFFECTS = {Effect.ALLOW: "Permit", Effect.DENY: "Deny"}


_XacmlRule = tuple[Rule, Mapping[Attribute, Collection[TextMatch]]]
"""The rule that a rule of XACML comes from, and by attribute what any of matches; it has one kind, without parts.

Every partition matches if there is none.
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
            target = {KIND: [TextMatch(kind)], ACTION: [*map(TextMatch, permissions)], NAME: [*names]}
            yield rule, {**target, PARTITION: partitions} if partitions else target


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
    attributes = _of_policy_set("policies", DENY_UNLESS_PERMIT)
    outer = etree.Element(f"{{{NAMESPACE}}}PolicySet", attributes, nsmap={None: NAMESPACE})  # type: ignore[dict-item]
    _child(outer, "Description", _DESCRIPTION)
    _child(outer, "Target")
    inner = _child(outer, "PolicySet", **_of_policy_set("subjects", POLICIES_DENY_OVERRIDES))
    _child(inner, "Target")
    # This policy denies a request without exactly one value of each attribute.
    guard = _policy(inner, "one-value-of-each-attribute", "Without exactly one value of each attribute.")
    _child(guard, "Target")
    condition = _child(_child(guard, "Rule", RuleId="1", Effect="Deny"), "Condition")
    all_of = _child(_child(condition, "Apply", FunctionId=NOT), "Apply", FunctionId=AND)
    for attribute in ATTRIBUTES:
        equal = _child(all_of, "Apply", FunctionId=INTEGER_EQUAL)
        _designator(_child(equal, "Apply", FunctionId=BAG_SIZE), attribute)
        _child(equal, "AttributeValue", "1", DataType=INTEGER)
    for subject, rules in subjects:
        if not rules:
            continue  # the outer set denies everything
        policy = _policy(inner, f"subject:{percent_encoded(subject)}", subject)
        _any_of(_child(policy, "Target"), SUBJECT, [TextMatch(subject)])
        for number, said in enumerate(rules, 1):
            _rule(policy, number, *said)
    etree.indent(outer)
    text = etree.tostring(outer, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _child(parent: etree._Element, tag: str, text: str = "", **attributes: str) -> etree._Element:
    element = etree.SubElement(parent, f"{{{NAMESPACE}}}{tag}", attributes)
    element.text = text or None
    return element


def _of_policy_set(name: str, algorithm: str) -> dict[str, str]:
    """Return the attributes of a policy set."""
    return {"PolicySetId": f"{OWN}{name}", "Version": "1.0", "PolicyCombiningAlgId": algorithm}


def _policy(parent: etree._Element, name: str, description: str) -> etree._Element:
    policy = _child(parent, "Policy", PolicyId=f"{OWN}{name}", Version="1.0", RuleCombiningAlgId=RULES_DENY_OVERRIDES)
    _child(policy, "Description", description)
    return policy


def _rule(policy: etree._Element, number: int, said: Rule, matches: Mapping[Attribute, Collection[TextMatch]]) -> None:
    """Add a rule, with its file and line as its description, without the folder, which differs between machines."""
    effect, place = _EFFECTS[said.effect], said.origin
    origin = f"{one_line(posixpath.basename(place.file))}:{place.line}"
    rule = _child(policy, "Rule", RuleId=str(number), Effect=effect)
    _child(rule, "Description", origin)
    target = _child(rule, "Target")
    for attribute, any_of in matches.items():
        _any_of(target, attribute, any_of)
    if said.audit:
        advice = _child(_child(rule, "AdviceExpressions"), "AdviceExpression", AdviceId=AUDIT, AppliesTo=effect)
        _child(
            _child(advice, "AttributeAssignmentExpression", AttributeId=ORIGIN),
            "AttributeValue", origin, DataType=STRING,
        )  # fmt: skip


def _any_of(target: etree._Element, attribute: Attribute, matches: Iterable[TextMatch]) -> None:
    any_of = _child(target, "AnyOf")
    for each in matches:
        function = REGULAR_MATCH if each.is_regular else STRING_EQUAL
        match = _child(_child(any_of, "AllOf"), "Match", MatchId=function)
        _child(match, "AttributeValue", each.text, DataType=STRING)
        _designator(match, attribute)


def _designator(parent: etree._Element, attribute: Attribute) -> None:
    category, name = attribute
    _child(
        parent, "AttributeDesignator",
        Category=category, AttributeId=name, DataType=STRING, MustBePresent="false",
    )  # fmt: skip
