# SPDX-License-Identifier: Apache-2.0
"""What findings say: notes and lists for messages, and the attachment that each expression of a rule comes from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

from comarmor.text import first_few
from comarmor.values import Data
from keymint.analysis.subject_patterns import expressions_for
from keymint.api import PolicyStructure, WrittenRule
from keymint.errors import Diagnostic, Origin, Spot
from keymint.ir import Rule


def undecided_note(message: str, help_: str, where: Origin | None = None) -> Diagnostic:
    """Return a note that a check ended at its limit of steps."""
    return Diagnostic.note("lint-unknown", message, where, help_)


def quoted_list(expressions: Sequence[str]) -> str:
    """Return the first expressions for a message."""
    return first_few([repr(each) for each in expressions], 3)


class ExpressionOrigin(Data):
    """Origin of an expression: an attachment of a rule.

    Attributes:
        where: its origin.
        number: index among the expressions of that origin; a tunable with several values has several.
    """

    where: Origin
    number: int


class ExpressionOrigins:
    """Finds the attachments of rules.

    Args:
        written: structure of the policy; without it the rule's origin is used.
    """

    def __init__(self, written: PolicyStructure | None) -> None:
        self._written = written

    @cached_property
    def _clauses(self) -> Mapping[Origin, WrittenRule]:
        """The rules as they are written, by their origin; most policies have no finding that asks for them."""
        return {clause.rule.origin: clause for clause in (self._written.clauses if self._written else ())}

    def clause(self, rule: Rule, attachment: ExpressionOrigin) -> tuple[WrittenRule, int] | None:
        """Return the clause of a rule, and the index of the expression of an attachment; None if unknown."""
        clause = self._clauses.get(rule.origin)
        if clause is None:
            return None
        indices = [at for at, where in enumerate(clause.places) if where.spot == attachment.where.spot]
        return (clause, indices[attachment.number]) if attachment.number < len(indices) else None

    def of(self, rule: Rule, subject: str) -> Mapping[str, ExpressionOrigin]:
        """Return the attachment of each expression of a subject's rule; of equal expressions the first."""
        clause = self._clauses.get(rule.origin)
        if clause is None or not clause.places:
            return {expression: ExpressionOrigin(rule.origin, at) for at, expression in enumerate(rule.expressions)}
        attachments: dict[str, ExpressionOrigin] = {}
        seen: dict[Spot, int] = {}
        for expression, where in zip(expressions_for(clause, subject), clause.places, strict=True):
            spot = where.spot
            number = seen.get(spot, 0)
            seen[spot] = number + 1
            if expression not in attachments:
                attachments[expression] = ExpressionOrigin(where, number)
        return attachments
