# SPDX-License-Identifier: Apache-2.0
"""Rules as a policy set of XACML 3.0.

What the rules do not decide is denied by the outer set (``deny-unless-permit``). That algorithm alone would let a
permit override a denial, so all policies are in an inner set with ``deny-overrides``. A policy has the rules of one
subject. A rule for composite objects becomes one rule for each part: who asks for such an object asks for all its parts
(:data:`comarmor.rules.PARTS`).

A first policy denies what does not have exactly one value of each attribute: in XACML, one that matches is enough.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterable, Iterator, Sequence
from urllib.parse import quote

from lxml import etree

from comarmor.errors import Diagnostic, Severity
from comarmor.rules import Effect, Rule, parts
from comarmor.text import printable, quoted
from comarmor.values import dataclass
from keymint.api import WrittenPolicy
from keymint.errors import KeymintError, UnsayableError
from keymint.ir import SubjectRules
from keymint_xacml import identifiers as ids
from keymint_xacml.identifiers import Attribute
from keymint_xacml.regular_expressions import TextMatch, text_match

_DESCRIPTION = (
    "Ask with one value of each attribute; that of the partition is empty for the default one. An object that has "
    "parts, as an action, is permitted if all of them are: ask for each."
)
_EFFECTS = {Effect.ALLOW: "Permit", Effect.DENY: "Deny"}


@dataclass(frozen=True, slots=True)
class _XacmlRule:
    """A rule of XACML, which has one kind of objects.

    Attributes:
        rule: the rule that it comes from.
        kind: a kind without parts.
        permissions: permissions of that kind.
        names: any of them matches.
        partitions: any of them matches; every partition does if there is none.
    """

    rule: Rule
    kind: str
    permissions: tuple[str, ...]
    names: tuple[TextMatch, ...]
    partitions: tuple[TextMatch, ...]


def written_policy(subjects: Sequence[SubjectRules], *, lossy: bool = False) -> WrittenPolicy:
    """Return the rules as a policy set; see :meth:`keymint.api.PolicyFormat.written`.

    Raises:
        KeymintError: an expression cannot be said; every such rule with its ``file:line``.
    """
    found: list[Diagnostic] = []
    said = [(each.subject, list(_rules(each, found, lossy=lossy))) for each in subjects]
    if any(each.severity is Severity.ERROR for each in found):
        raise KeymintError.of(dict.fromkeys(found))
    return WrittenPolicy(_document(said), tuple(dict.fromkeys(found)))


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
            yield _XacmlRule(rule, kind, permissions, tuple(names), partitions)


def _parts(rule: Rule) -> Iterator[tuple[str, tuple[str, ...], str]]:
    """Yield kind, permissions and suffix of the parts of a rule; a rule without parts stays one."""
    found = [part for permission in rule.permissions for part in parts(rule.kind, permission)]
    if all(kind == rule.kind for kind, _, _ in found):
        yield rule.kind, rule.permissions, ""
        return
    for kind, permission, suffix in found:
        yield kind, (permission,), suffix


def _unsayable(rule: Rule, reason: str, subject: str, *, lossy: bool) -> Diagnostic:
    message = f"XACML cannot say {rule.effect} {rule.kind} {quoted(', '.join(rule.expressions))}: {reason}"
    if lossy and rule.effect is Effect.ALLOW:
        return Diagnostic.warning("xacml-unsayable", message, rule.origin, "left out (--lossy)", subject)
    help_ = "change the expression" + ("; --lossy leaves it out" if rule.effect is Effect.ALLOW else "")
    return Diagnostic.error("xacml-unsayable", message, rule.origin, help_, subject)


def _document(subjects: Iterable[tuple[str, Sequence[_XacmlRule]]]) -> bytes:
    attributes = _of_policy_set("policies", ids.DENY_UNLESS_PERMIT)
    outer = etree.Element(f"{{{ids.NAMESPACE}}}PolicySet", attributes, nsmap={None: ids.NAMESPACE})  # type: ignore[dict-item]
    _child(outer, "Description", _DESCRIPTION)
    _child(outer, "Target")
    inner = _child(outer, "PolicySet", **_of_policy_set("subjects", ids.POLICIES_DENY_OVERRIDES))
    _child(inner, "Target")
    _guard(inner)
    for subject, rules in subjects:
        if not rules:
            continue  # the outer set denies everything
        policy = _policy(inner, f"subject:{quote(subject)}", subject)
        _any_of(_child(policy, "Target"), ids.SUBJECT, [TextMatch(subject)])
        for number, rule in enumerate(rules, 1):
            _rule(policy, number, rule)
    etree.indent(outer)
    text = etree.tostring(outer, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _child(parent: etree._Element, tag: str, text: str = "", **attributes: str) -> etree._Element:
    element = etree.SubElement(parent, f"{{{ids.NAMESPACE}}}{tag}", attributes)
    element.text = text or None
    return element


def _of_policy_set(name: str, algorithm: str) -> dict[str, str]:
    """Return the attributes of a policy set."""
    return {"PolicySetId": f"{ids.OWN}{name}", "Version": "1.0", "PolicyCombiningAlgId": algorithm}


def _policy(parent: etree._Element, name: str, description: str) -> etree._Element:
    policy = _child(
        parent, "Policy", PolicyId=f"{ids.OWN}{name}", Version="1.0", RuleCombiningAlgId=ids.RULES_DENY_OVERRIDES
    )
    _child(policy, "Description", description)
    return policy


def _guard(parent: etree._Element) -> None:
    """Add the policy that denies a request without exactly one value of each attribute."""
    policy = _policy(parent, "one-value-of-each-attribute", "Without exactly one value of each attribute.")
    _child(policy, "Target")
    condition = _child(_child(policy, "Rule", RuleId="1", Effect="Deny"), "Condition")
    all_of = _child(_child(condition, "Apply", FunctionId=ids.NOT), "Apply", FunctionId=ids.AND)
    for attribute in ids.ATTRIBUTES:
        equal = _child(all_of, "Apply", FunctionId=ids.INTEGER_EQUAL)
        _designator(_child(equal, "Apply", FunctionId=ids.BAG_SIZE), attribute)
        _child(equal, "AttributeValue", "1", DataType=ids.INTEGER)


def _rule(policy: etree._Element, number: int, said: _XacmlRule) -> None:
    """Add a rule, with its file and line as its description, without the folder, which differs between machines."""
    effect, place = _EFFECTS[said.rule.effect], said.rule.origin
    origin = f"{printable(posixpath.basename(place.file))}:{place.line}"
    rule = _child(policy, "Rule", RuleId=str(number), Effect=effect)
    _child(rule, "Description", origin)
    target = _child(rule, "Target")
    _any_of(target, ids.KIND, [TextMatch(said.kind)])
    _any_of(target, ids.ACTION, map(TextMatch, said.permissions))
    _any_of(target, ids.NAME, said.names)
    if said.partitions:
        _any_of(target, ids.PARTITION, said.partitions)
    if said.rule.audit:
        advice = _child(_child(rule, "AdviceExpressions"), "AdviceExpression", AdviceId=ids.AUDIT, AppliesTo=effect)
        _child(
            _child(advice, "AttributeAssignmentExpression", AttributeId=ids.ORIGIN),
            "AttributeValue", origin, DataType=ids.STRING,
        )  # fmt: skip


def _any_of(target: etree._Element, attribute: Attribute, matches: Iterable[TextMatch]) -> None:
    any_of = _child(target, "AnyOf")
    for each in matches:
        function = ids.REGULAR_MATCH if each.is_regular else ids.STRING_EQUAL
        match = _child(_child(any_of, "AllOf"), "Match", MatchId=function)
        _child(match, "AttributeValue", each.text, DataType=ids.STRING)
        _designator(match, attribute)


def _designator(parent: etree._Element, attribute: Attribute) -> None:
    _child(
        parent, "AttributeDesignator",
        Category=attribute.category, AttributeId=attribute.id, DataType=ids.STRING, MustBePresent="false",
    )  # fmt: skip
