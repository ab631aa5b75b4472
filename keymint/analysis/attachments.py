"""Where the expressions of a rule are written: the attachment that each of them comes from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from comarmor.errors import Origin, Spot
from keymint.analysis.rule_lists import text
from keymint.api import PolicyStructure, WrittenRule
from keymint.ir import Rule


@dataclass(frozen=True, slots=True)
class Attachment:
    """The attachment that an expression comes from.

    Attributes:
        where: where it is written.
        number: which of the expressions that are written there it is; several when a tunable has several values.
    """

    where: Origin
    number: int


class AttachmentIndex:
    """Finds the attachments of rules.

    Args:
        written: the policy as it is written; None if its type does not tell, so that a rule's own place has to do.
    """

    def __init__(self, written: PolicyStructure | None) -> None:
        self._clauses: dict[Origin, WrittenRule] = {
            clause.rule.origin: clause for clause in (written.clauses if written else ())
        }

    def clause(self, rule: Rule, attachment: Attachment) -> tuple[WrittenRule, int] | None:
        """Return a rule as it is written, and which of its expressions comes from an attachment; None if not known."""
        clause = self._clauses.get(rule.origin)
        if clause is None:
            return None
        there = [at for at, where in enumerate(clause.places) if where.spot == attachment.where.spot]
        return (clause, there[attachment.number]) if attachment.number < len(there) else None

    def of(self, rule: Rule, subject: str) -> Mapping[str, Attachment]:
        """Return the attachment of each expression of a rule of a subject; of equal ones the first."""
        clause = self._clauses.get(rule.origin)
        if clause is None or not clause.places:
            return {expression: Attachment(rule.origin, at) for at, expression in enumerate(rule.expressions)}
        head, _, last = subject.rpartition("/")
        found: dict[str, Attachment] = {}
        counted: Counter[Spot] = Counter()
        for expression, where in zip(clause.expand(text((f"{head}/",)), text((last,))), clause.places, strict=True):
            found.setdefault(expression, Attachment(where, counted[where.spot]))
            counted[where.spot] += 1
        return found
