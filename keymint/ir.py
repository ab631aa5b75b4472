"""The intermediate representation: what a subject may do, agnostic of policy format and of transport.

A policy plugin turns its format into these types, a build plugin turns them into a transport's documents.
The meaning of a list of rules is that of mandatory access control with deny overrides: for a kind, a permission
and an object, deny if any DENY rule matches, else allow if any ALLOW rule does, else deny. Order has no meaning.
"""

from __future__ import annotations

from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.rules import Effect


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule of a subject.

    Attributes:
        effect: allow or deny.
        kind: a key of :data:`PERMISSIONS`.
        permissions: permissions of that kind, without doubles.
        expressions: POSIX ``fnmatch`` expressions (flags 0, ``\\`` escapes), fully expanded: no tunable, no
            ``{name}``; an object matches when any of them matches its whole name.
        partitions: only for kind ``topic``: DDS partitions as ``fnmatch`` expressions; empty means not narrowed:
            an ALLOW is then about the default (empty) partition, a DENY about every partition.
        audit: the rule is to be watched; changes no decision.
        origin: where a person wrote it.
    """

    effect: Effect
    kind: str
    permissions: tuple[str, ...]
    expressions: tuple[str, ...]
    partitions: tuple[str, ...]
    audit: bool
    origin: Origin


@dataclass(frozen=True, slots=True)
class SubjectRules:
    """All rules that apply to one subject.

    Attributes:
        subject: the subject's name, e.g. ``/robot1/talker``.
        rules: unordered in meaning; kept in the order of the policy for readers.
    """

    subject: str
    rules: tuple[Rule, ...]
