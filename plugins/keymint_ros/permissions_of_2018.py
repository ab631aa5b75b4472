# SPDX-License-Identifier: Apache-2.0
"""What a ``permissions.xml`` of 2018 says that the rules of the policy do not, before these replace it.

The tool of 2018 wrote the document from the policy as well, so both say the same unless somebody edited one of them.
They are compared as they are written: each permission on each expression.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from comarmor.errors import Diagnostic, Origin
from comarmor.rules import KIND_OF, Effect
from comarmor.text import quoted
from comarmor.values import dataclass
from comarmor.xml import reader
from comarmor.xml.reader import line

if TYPE_CHECKING:
    from lxml import etree

    from keymint.ir import SubjectRules

_EFFECTS = {"allow_rule": Effect.ALLOW, "deny_rule": Effect.DENY}
_OF_GRANT = ("subject_name", "validity")


@dataclass(frozen=True, slots=True)
class _Right:
    """A permission on an expression."""

    effect: Effect
    permission: str
    expression: str
    partitions: tuple[str, ...]

    def __str__(self) -> str:
        inside = f" in {', '.join(map(quoted, self.partitions))}" if self.partitions else ""
        return f"{self.effect} {self.permission} {quoted(self.expression)}{inside}"


def differences(content: bytes, file: str, rules: SubjectRules) -> tuple[Diagnostic, ...]:
    """Return what a document of 2018 says and the rules of the policy do not, and the other way, as warnings.

    Args:
        content: the document; must be well-formed.
        file: its path, for messages.
        rules: the rules that replace it.
    """
    root = reader.parse(content, file)
    then: dict[_Right, int] = {}
    others: dict[str, int] = {}
    for element in root.iterfind("permissions/grant/*"):
        tag = str(element.tag)
        if tag in _EFFECTS:
            for right, place in _rights(element, others):
                then.setdefault(right, place)
        elif tag in _OF_GRANT or (tag == "default" and (element.text or "").strip() != Effect.DENY):
            others.setdefault(tag, line(element))
    now = dict.fromkeys(
        _Right(rule.effect, permission, expression, rule.partitions)
        for rule in rules.rules
        for permission in rule.permissions
        for expression in rule.expressions
    )
    only_then = [right for right in then if right not in now]
    only_now = [right for right in now if right not in then]
    found = []
    if only_then:
        found.append((then[only_then[0]], f"said {_some(only_then)}, which the policy does not say"))
    if only_now:
        found.append((0, f"did not say {_some(only_now)}, which the policy says"))
    found += [(place, f"had <{tag}> of its own, which the new one has not") for tag, place in others.items()]
    return tuple(
        Diagnostic.warning(
            "permissions-of-2018", f"the permissions of 2018 {text}", Origin(file, place),
            f"they are kept as {file.rpartition('/')[2]}.2018; change the policy, or the new file, if they are right",
            rules.subject
        )
        for place, text in found
    )  # fmt: skip


def _some(rights: list[_Right]) -> str:
    others = len(rights) - 1
    return str(rights[0]) if not others else f"{rights[0]} and {others} more"


def _rights(rule: etree._Element, others: dict[str, int]) -> Iterator[tuple[_Right, int]]:
    """Yield what a rule says, with its line, and add the elements that have no place in the rules of a policy."""
    for criteria in rule:
        permission = str(criteria.tag)
        if permission not in KIND_OF:
            others.setdefault(permission, line(criteria))
            continue
        partitions = tuple((each.text or "").strip() for each in criteria.iterfind("partitions/partition"))
        for group in criteria:
            if group.tag == "partitions":
                continue
            if group.tag != f"{KIND_OF[permission]}s":
                others.setdefault(str(group.tag), line(group))
                continue
            for each in group:
                expression = (each.text or "").strip()
                yield _Right(_EFFECTS[str(rule.tag)], permission, expression, partitions), line(each)
