# SPDX-License-Identifier: Apache-2.0
"""The rights of subjects ordered by risk, and who can reach what, for ``keymint report``; as JSON data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from comarmor.patterns.glob import Glob, literal, parse
from comarmor.patterns.relations import disjoint
from comarmor.rules import Rule, of_raw_topic
from comarmor.text import natural_order
from keymint.analysis.query import PermissionHolder, effective_permissions, who_can
from keymint.analysis.rule_lists import display_name, query_pattern
from keymint.analysis.subject_patterns import representatives, rules_of
from keymint.api import LoadedPolicy
from keymint.errors import Origin
from keymint.names import RAW
from keymint.output.json import Typed, line_json
from keymint.output.report import members

RISKS = {"safety": 4, "wildcard": 2, "parameters": 1}
"""Why a right is risky, each with its weight. ``safety``: it is about an object that the user calls critical;
``wildcard``: about names that nobody wrote down; ``parameters``: it may read or change parameters of other nodes."""
MOST = 500
"""So many objects are asked about; each question is about all possible subjects."""
_EVERYBODY = parse("*")


def rights_json(
    policy: LoadedPolicy, safety: Sequence[Glob], library: Callable[[Origin], bool], typed: Typed
) -> list[dict[str, Any]]:
    """Return the rights of all subjects that a policy names, the riskiest first; then by subject.

    Args:
        policy: the policy.
        safety: patterns of the objects that are critical.
        library: tells whether a rule is one of the library of policies.
        typed: returns a path as the user would type it.
    """
    found = [
        right | {"kind": rule.kind, "risks": list(_risks(rule, right, safety)), "library": library(rule.origin)}
        for rule, right in subject_rights(policy, representatives(policy, _EVERYBODY), typed)
    ]
    return sorted(found, key=lambda each: (-_weight(each), *map(natural_order, (each["subject"], each["expression"]))))


def subject_rights(
    policy: LoadedPolicy, subjects: Iterable[str], typed: Typed = str
) -> Iterator[tuple[Rule, dict[str, Any]]]:
    """Yield each right of some subjects as JSON data, with its rule.

    Args:
        policy: the policy.
        subjects: their names.
        typed: returns a path as the user would type it [as it is].
    """
    for subject in subjects:
        for rule, permission, expression, but in effective_permissions(rules_of(policy, subject)):
            yield (
                rule,
                {
                    "subject": subject,
                    "permission": permission,
                    "expression": expression,
                    "partitions": rule.partitions,
                    "except": but,
                    "audit": rule.audit,
                    "rule": line_json(rule.origin, typed),
                },
            )


def _weight(right: Mapping[str, Any]) -> int:
    return sum(RISKS[each] for each in right["risks"])


def _risks(rule: Rule, right: Mapping[str, Any], safety: Sequence[Glob]) -> Iterator[str]:
    pattern = parse(right["expression"])
    if any(not disjoint(pattern, each) for each in safety):
        yield "safety"
    if any(literal(each) is None for each in (pattern, *map(parse, rule.partitions))):
        yield "wildcard"
    if rule.kind == "ros_parameter" or (right["permission"] == "ros_call" and "parameter" in right["expression"]):
        yield "parameters"


def reach_json(
    policy: LoadedPolicy, rights: Sequence[Mapping[str, Any]], typed: Typed
) -> tuple[list[dict[str, Any]], int]:
    """Return who can use each object that a right is about, of all possible subjects, and how many are left out.

    Args:
        policy: the policy.
        rights: the rights, the riskiest first.
        typed: returns a path as the user would type it.
    """
    questions: dict[tuple[str, str, str, str], dict[str, bool]] = {}
    for each in rights:
        about = each["kind"], each["permission"], each["expression"]
        for partition in each["partitions"] or ("",):
            known = questions.setdefault((*about, partition), {"safety": "safety" in each["risks"], "library": True})
            known["library"] &= each["library"]
    asked = list(questions.items())[:MOST]
    found: list[dict[str, Any]] = [
        {
            "kind": kind,
            "permission": permission,
            "expression": expression,
            "partition": partition or None,
            **known,
            "holders": [
                holder_json(holder, *each[:2], typed)
                for each in _meant(kind, permission, expression, partition)
                for holder in who_can(policy, _EVERYBODY, *each[:2], query_pattern(each[0], each[2], partition))
            ],
        }
        for (kind, permission, expression, partition), known in asked
    ]
    found.sort(key=lambda each: natural_order(f"{each['expression']} {each['permission']}"))
    return found, len(questions) - len(asked)


def _meant(kind: str, permission: str, expression: str, partition: str) -> Iterator[tuple[str, str, str]]:
    """Yield kind, permission and expression of a right, and those of the ROS name that maps to it if it is raw."""
    yield kind, permission, expression
    if kind == RAW and not partition and (ros := of_raw_topic(permission, expression)):
        yield ros


def holder_json(holder: PermissionHolder, kind: str, permission: str, typed: Typed = str) -> dict[str, Any]:
    """Return a subject that has a permission on objects of a kind, or may have it, as JSON data."""
    return {
        **members(holder, "subject", "like"),
        "permission": permission,
        "object": display_name(kind, holder.word) or None,
        "rule": line_json(holder.where, typed),
        **members(holder, "unknown"),
    }
