# SPDX-License-Identifier: Apache-2.0
"""Decides requests by a policy of XACML 3.0, for the part of the standard that exports use.

It shares no code with what writes them: it knows the standard (sections 7.6 to 7.13, appendices A and C), and refuses
everything else.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element

Request = Mapping[tuple[str, str], Sequence[str]]
"""The values of each attribute, by category and identifier."""

_XACML = "{urn:oasis:names:tc:xacml:3.0:core:schema:wd-17}"
_FUNCTION = "urn:oasis:names:tc:xacml:1.0:function:"
_STRING, _INTEGER = "http://www.w3.org/2001/XMLSchema#string", "http://www.w3.org/2001/XMLSchema#integer"
PERMIT, DENY, NOT_APPLICABLE = "Permit", "Deny", "NotApplicable"


@dataclass(frozen=True)
class Result:
    """A decision, and the values that its advice assigns."""

    decision: str
    advice: frozenset[str] = frozenset()


_Node = Callable[[Request], Result]


def evaluator(document: bytes) -> _Node:
    """Return what decides requests by a policy set."""
    return _policy_set(ET.fromstring(document))


def _local(element: Element) -> str:
    assert element.tag.startswith(_XACML)
    return element.tag.removeprefix(_XACML)


def _policy_set(element: Element) -> _Node:
    children = [each for each in element if _local(each) not in {"Description", "Target"}]
    parts = [{"PolicySet": _policy_set, "Policy": _policy}[_local(each)](each) for each in children]
    assert element.attrib.keys() == {"PolicySetId", "Version", "PolicyCombiningAlgId"}
    return _combined(element, parts, element.attrib["PolicyCombiningAlgId"].replace("policy-combining", "combining"))


def _policy(element: Element) -> _Node:
    children = [each for each in element if _local(each) not in {"Description", "Target"}]
    assert {_local(each) for each in children} == {"Rule"}
    assert len({each.attrib["RuleId"] for each in children}) == len(children)
    assert element.attrib.keys() == {"PolicyId", "Version", "RuleCombiningAlgId"}
    rules = [_rule(each) for each in children]
    return _combined(element, rules, element.attrib["RuleCombiningAlgId"].replace("rule-combining", "combining"))


def _combined(element: Element, parts: Sequence[_Node], algorithm: str) -> _Node:
    target = _target(element.find(f"{_XACML}Target"))
    prefix = "urn:oasis:names:tc:xacml:3.0:combining-algorithm:"
    combine = {f"{prefix}deny-overrides": _deny_overrides, f"{prefix}deny-unless-permit": _deny_unless_permit}
    return lambda request: combine[algorithm](parts, request) if target(request) else Result(NOT_APPLICABLE)


def _of(results: Sequence[Result], decision: str) -> Result:
    advice = [each.advice for each in results if each.decision == decision]
    return Result(decision, frozenset().union(*advice))


def _deny_overrides(parts: Sequence[_Node], request: Request) -> Result:
    """Appendix C.2, for requests that are never indeterminate."""
    results = [part(request) for part in parts]
    decisions = {each.decision for each in results}
    return _of(results, DENY if DENY in decisions else PERMIT if PERMIT in decisions else NOT_APPLICABLE)


def _deny_unless_permit(parts: Sequence[_Node], request: Request) -> Result:
    """Appendix C.7."""
    results = [part(request) for part in parts]
    return _of(results, PERMIT if any(each.decision == PERMIT for each in results) else DENY)


def _rule(element: Element) -> _Node:
    effect = element.attrib["Effect"]
    assert effect in {PERMIT, DENY}
    by_tag = {_local(each): each for each in element}
    assert by_tag.keys() <= {"Description", "Target", "Condition", "AdviceExpressions"}
    target = _target(by_tag.get("Target"))
    condition = _expression(by_tag["Condition"][0]) if "Condition" in by_tag else lambda _: True
    advice = _advice(by_tag.get("AdviceExpressions"), effect)
    return lambda request: Result(effect, advice) if target(request) and condition(request) else Result(NOT_APPLICABLE)


def _advice(element: Element | None, effect: str) -> frozenset[str]:
    values = []
    for each in () if element is None else element:
        assert _local(each) == "AdviceExpression"
        if each.attrib["AppliesTo"] == effect:
            values += [assignment[0].text or "" for assignment in each]
    return frozenset(values)


def _target(element: Element | None) -> Callable[[Request], bool]:
    """Section 7.7: every AnyOf has an AllOf whose matches all match."""
    any_ofs = [
        [[_match(match) for match in all_of] for all_of in any_of] for any_of in (() if element is None else element)
    ]
    return lambda request: all(any(all(match(request) for match in all_of) for all_of in any_of) for any_of in any_ofs)


def _match(element: Element) -> Callable[[Request], bool]:
    """Section 7.6: the function is true for the value and at least one value of the request."""
    value, designator = element
    assert value.attrib["DataType"] == _STRING
    attribute, text = _attribute(designator), value.text or ""
    if element.attrib["MatchId"] == f"{_FUNCTION}string-equal":
        return lambda request: text in request.get(attribute, ())
    assert element.attrib["MatchId"] == f"{_FUNCTION}string-regexp-match"
    search = re.compile(_of_python(text)).search
    return lambda request: any(search(each) for each in request.get(attribute, ()))


def _of_python(expression: str) -> str:
    """Return an expression of XPath 2.0 in the dialect of Python, where ``$`` also matches before a last line feed."""
    assert not re.search(r"(?<!\\)(?:\\\\)*\\[^\\|.\-^?*+{}()\[\]$nrtsS]", expression)
    assert expression.endswith("$")
    return expression.removesuffix("$") + r"\Z"


def _attribute(element: Element) -> tuple[str, str]:
    assert _local(element) == "AttributeDesignator"
    assert element.attrib["DataType"] == _STRING
    assert element.attrib["MustBePresent"] == "false"
    return element.attrib["Category"], element.attrib["AttributeId"]


def _expression(element: Element) -> Callable[[Request], bool | int]:
    """Appendix A.3, the functions of conditions."""
    if _local(element) == "AttributeValue":
        assert element.attrib["DataType"] == _INTEGER
        number = int(element.text or "")
        return lambda _: number
    function = element.attrib["FunctionId"].removeprefix(_FUNCTION)
    if function == "string-bag-size":
        attribute = _attribute(element[0])
        return lambda request: len(request.get(attribute, ()))
    arguments = [_expression(each) for each in element]
    if function == "not":
        (argument,) = arguments
        return lambda request: not argument(request)
    if function == "integer-equal":
        one, other = arguments
        return lambda request: one(request) == other(request)
    assert function == "and"
    return lambda request: all(argument(request) for argument in arguments)
