# SPDX-License-Identifier: Apache-2.0
"""Whether a rule applies to a request."""

from __future__ import annotations

from comarmor.patterns.expression import matches
from comarmor.rules import Effect, Rule, suffixes


def rule_matches(rule: Rule, kind: str, permission: str, name: str) -> bool:
    """Return whether a rule applies to an object, directly or because the object implements a composite permission.

    Args:
        rule: the rule.
        kind: kind of the object.
        permission: a permission that is not composite.
        name: name of the object.
    """
    return any(
        name.endswith(suffix) and any(matches(expression, name.removesuffix(suffix)) for expression in rule.expressions)
        for suffix in suffixes(rule, kind, permission)
    )


def rule_matches_partition(rule: Rule, partition: str) -> bool:
    """Return whether a rule applies to a partition; one without partitions allows the default one, and denies all."""
    if rule.partitions:
        return any(matches(expression, partition) for expression in rule.partitions)
    return rule.effect is Effect.DENY or partition == ""
