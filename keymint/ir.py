# SPDX-License-Identifier: Apache-2.0
"""The intermediate representation: the rules of a subject, independent of policy format and transport.

A policy plugin turns its format into these types, and a build plugin turns them into a transport's documents.
The rules are mandatory access control in which DENY overrides ALLOW: a request (kind, permission, object) is denied if
any DENY rule matches it, else allowed if any ALLOW rule does, else denied. The order of rules has no meaning.
"""

from __future__ import annotations

from comarmor.rules import Rule
from comarmor.values import dataclass

__all__ = ["Rule", "SubjectRules"]


@dataclass(frozen=True, slots=True)
class SubjectRules:
    """All rules that apply to one subject.

    Attributes:
        subject: the subject's name, e.g. ``/robot1/talker``.
        rules: in the order of the policy, which has no meaning.
    """

    subject: str
    rules: tuple[Rule, ...]
