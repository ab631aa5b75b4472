# SPDX-License-Identifier: Apache-2.0
"""The intermediate representation: the rules of a subject, independent of policy format and transport.

A policy plugin turns its format into these types, and a build plugin turns them into a transport's documents.
The rules are mandatory access control in which DENY overrides ALLOW: a request (kind, permission, object) is denied if
any DENY rule matches it, else allowed if any ALLOW rule does, else denied. The order of rules has no meaning.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from comarmor.rules import Rule
from comarmor.values import dataclass

__all__ = ["DeferredRules", "Rule", "SubjectRules"]


@dataclass(frozen=True, slots=True)
class SubjectRules:
    """All rules that apply to one subject.

    Attributes:
        subject: the subject's name, e.g. ``/robot1/talker``.
        rules: in the order of the policy, which has no meaning.
    """

    subject: str
    rules: tuple[Rule, ...]


class DeferredRules(SubjectRules):
    """Rules that are read when they are first asked for.

    Args:
        subject: the subject's name.
        read: returns the rules; its errors are raised by :attr:`rules`.
    """

    __slots__ = ("_read",)
    _read: Callable[[], tuple[Rule, ...]]

    def __init__(self, subject: str, read: Callable[[], tuple[Rule, ...]]) -> None:
        object.__setattr__(self, "subject", subject)
        object.__setattr__(self, "_read", functools.cache(read))

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rules, in the order of the policy."""
        return self._read()

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what another process makes of them: rules that were read."""
        return SubjectRules, (self.subject, self.rules)
