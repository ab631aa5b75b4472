# SPDX-License-Identifier: Apache-2.0
"""What the access control of a configuration permits on a link, as key expressions for each message and flow."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint_ros2_zenoh.documents.access_control import AccessControl, AclPolicy, AclRule, AclSubject
from keymint_ros2_zenoh.keyexpr.key_expr import KeyExpr, parse
from keymint_ros2_zenoh.messages import Flow, Message, Permission


@dataclass(frozen=True, slots=True)
class LinkRights:
    """What applies to the links of a certificate's common name.

    Attributes:
        entries: the rules of each entry that matches the links.
        open: without a matching rule a message is permitted.
        unmodelled: why it is not known which entries match; empty if it is.
        where: the place of the access control.
    """

    entries: tuple[tuple[AclRule, ...], ...]
    open: bool
    unmodelled: str = ""
    where: Origin | None = None

    def keys(self, message: Message, flow: Flow) -> tuple[tuple[tuple[KeyExpr, ...], tuple[KeyExpr, ...]], ...]:
        """Return for each entry the key expressions that it allows, and those that it denies."""
        return tuple(
            (_keys(rules, message, flow, Permission.ALLOW), _keys(rules, message, flow, Permission.DENY))
            for rules in self.entries
        )


class RouterRights:
    """Finds what applies to the links of a common name; one for all enclaves, since the file has the rights of all.

    Attributes:
        control: the access control.
    """

    def __init__(self, control: AccessControl) -> None:
        self.control = control
        self._rules = {rule.id: rule for rule in control.rules}
        self._named: dict[str, list[AclSubject]] = {}
        for subject in control.subjects:
            for name in subject.common_names or ("",):
                self._named.setdefault(name, []).append(subject)
        self._policies: dict[str, list[AclPolicy]] = {}
        for policy in control.policies:
            for name in policy.subjects:
                self._policies.setdefault(name, []).append(policy)

    def on(self, common_name: str) -> LinkRights:
        """Return what applies to links whose certificate has a common name first."""
        control = self.control
        if not control.enabled:
            return LinkRights(((),), open=True, where=control.where)
        # Subjects with equal properties are one entry.
        matching = [self._named.get(name, []) for name in dict.fromkeys((common_name, ""))]
        other = next((each for group in matching for each in group if each.depends_on_more), None)
        unmodelled = "" if other is None else f"the subject {other.id!r} also depends on more than certificates"
        entries = tuple(tuple(self._rules_of(group)) for group in matching if group)
        return LinkRights(entries or ((),), control.default_permission is Permission.ALLOW, unmodelled, control.where)

    def _rules_of(self, subjects: Iterable[AclSubject]) -> Iterator[AclRule]:
        policies = (policy for subject in subjects for policy in self._policies.get(subject.id, ()))
        for name in dict.fromkeys(name for policy in policies for name in policy.rules):
            yield self._rules[name]


def _keys(rules: Iterable[AclRule], message: Message, flow: Flow, permission: Permission) -> tuple[KeyExpr, ...]:
    return tuple(
        parse(text)
        for rule in rules
        if rule.permission is permission and message in rule.messages and flow in rule.flows
        for text in rule.key_exprs
    )
