# SPDX-License-Identifier: Apache-2.0
"""Denials that hold for literal keys only.

A router denies what a denial includes. A message may have a key expression in place of a key: ``0/*/x/…`` meets the
denied ``0/secret/x/…`` without being included in it. Nodes send literal keys only; a hostile session need not. Its
message reaches a receiver of the denied name if this may receive such key expressions too.
"""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic
from comarmor.patterns.relations import disjoint
from comarmor.rules import Effect
from keymint_ros2_zenoh.keyexpr.key_expansion import key_exprs
from keymint_ros2_zenoh.keyexpr.key_expr import KeyExpr
from keymint_ros2_zenoh.keyexpr.key_relations import includes, intersects
from keymint_ros2_zenoh.lowering.name_rules import NameRule, NameRules

SENDING = ("ros_publish", "ros_call")
"""The permissions to send: what a subject may receive, its peers decide by what they may send."""
_ASKING = "ros_subscribe"
"""A late subscriber asks for cached data, and gets it if replies are not denied because it may call a service."""


def deny_wildcards(names: NameRules) -> Iterator[Diagnostic]:
    """Yield a warning for each DENY rule of a subject that an allowed key expression meets without being included."""
    reported = set()
    for permission in (*SENDING, _ASKING):
        allowed = [each for each in names.rules if (each.effect, each.permission) == (Effect.ALLOW, permission)]
        wild = [(key, each) for each in allowed for key in key_exprs(each.pattern) if not key.is_literal]
        for denial in names.rules:
            if (denial.effect, denial.permission) != (Effect.DENY, permission) or denial.rule.origin in reported:
                continue
            if permission == _ASKING and not _answered(names, denial):
                continue
            found = _met(denial, wild)
            if found:
                reported.add(denial.rule.origin)
                yield _warning(denial, *found, names.subject)


def _answered(names: NameRules, denial: NameRule) -> bool:
    """Return whether a reply about a denied name may reach the subject."""
    return any(not disjoint(denial.pattern, called) for called in names.patterns(Effect.ALLOW, "ros_call"))


def _met(denial: NameRule, wild: list[tuple[KeyExpr, NameRule]]) -> tuple[KeyExpr, NameRule] | None:
    """Return the first key expression that a denial meets and does not include, with its rule."""
    for denied in key_exprs(denial.pattern):
        for key, allowing in wild:
            if intersects(key, denied) and not includes(denied, key):
                return key, allowing
    return None


def _warning(denial: NameRule, key: KeyExpr, allowing: NameRule, subject: str) -> Diagnostic:
    message = (
        f"this DENY {denial.rule.kind} rule holds for names only: the ALLOW rule at {allowing.rule.origin} also "
        f"permits key expressions such as '<domain>/{key}/…', which cover a denied name; a hostile process can send "
        "them, and they arrive where a receiver may receive them"
    )
    return Diagnostic.warning(
        "zenoh-deny-wildcard",
        message,
        denial.rule.origin,
        "allow the names that the subject needs instead of a wildcard",
        subject,
    )
