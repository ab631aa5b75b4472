# SPDX-License-Identifier: Apache-2.0
"""Policies of the ComArmor language as loaded policies, for every policy type that makes such policies.

Also their structure as it is written, for analyses of subjects that they do not name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import comarmor
from comarmor.language.policy import Ruling
from comarmor.rules import Effect
from comarmor.xml.package_folders import ShippedFile
from keymint import api
from keymint.api import AppliedProfile, LoadedPolicy, PolicyDecision, PolicyStructure, WrittenProfile, WrittenRule
from keymint.errors import Diagnostic
from keymint.ir import SubjectRules

_MOST_KNOWN = 1 << 10
"""Subjects whose rules, with what is known of these, are kept for all stages."""


class ComArmorPolicy(LoadedPolicy):
    """A loaded ComArmor policy."""

    def __init__(self, policy: comarmor.Policy, findings: Sequence[Diagnostic] = ()) -> None:
        self.policy = policy
        self._findings = findings
        self._structure: PolicyStructure | None = None
        self._known: dict[str, SubjectRules] = {}

    @property
    def findings(self) -> Sequence[Diagnostic]:
        """See :attr:`keymint.api.LoadedPolicy.findings`."""
        return self._findings

    @property
    def seen(self) -> Mapping[Path, bytes]:
        """Every path that loading looked at, with its fingerprint."""
        return self.policy.seen

    @property
    def shipped(self) -> tuple[ShippedFile, ...]:
        """See :attr:`keymint.api.LoadedPolicy.shipped`."""
        return self.policy.shipped

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that the policy names exactly."""
        return self.policy.subjects()

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject, or None when no profile applies to it."""
        known = self._known.get(subject)
        if known is None and self.policy.applicable(subject):
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            known = self._known[subject] = SubjectRules(subject, self.policy.rules(subject))
        return known

    def root_profiles(self) -> tuple[str, ...]:
        """See :meth:`keymint.api.LoadedPolicy.root_profiles`."""
        return tuple(profile.name for profile in self.policy.profiles)

    def rules_digest(self, subject: str) -> str | None:
        """See :meth:`keymint.api.LoadedPolicy.rules_digest`."""
        return self.policy.rules_digest(subject)

    def profiles(self, subject: str) -> tuple[AppliedProfile, ...]:
        """Return the profiles that apply to a subject, outer ones first."""
        return tuple(
            AppliedProfile(profile.name, profile.where, profile.audit) for profile in self.policy.applicable(subject)
        )

    def structure(self) -> PolicyStructure:
        """Return the structure of the policy, which is made once."""
        if self._structure is None:  # a cache of the function would keep the policy
            self._structure = structure(self.policy)
        return self._structure

    def decide(self, edge: api.Edge) -> PolicyDecision:
        """See :meth:`keymint.api.LoadedPolicy.decide`."""
        requested = edge.object
        row = self.policy.row(edge.subject, requested.kind, edge.permission)
        return _decision(row.ruling(requested.name, requested.partitions))

    def allowed(self, subject: str, kind: str, permission: str, names: Iterable[str]) -> bytes:
        """See :meth:`keymint.api.LoadedPolicy.allowed`."""
        return self.policy.row(subject, kind, permission).allowed(names)


@lru_cache(maxsize=1024)
def _decision(ruling: Ruling) -> PolicyDecision:
    """Return the decision of a ruling, which most requests share with others."""
    where = ruling.rules[0].origin if ruling.rules else None
    audit = any(rule.audit for rule in ruling.rules)
    return PolicyDecision(ruling.effect is Effect.ALLOW, where, ruling.reason, audit)


_Around = tuple[tuple[str, ...], ...]


def structure(policy: comarmor.Policy) -> PolicyStructure:
    """Return the profiles and rules of a policy as they are written."""
    nested = tuple(_nested(policy.profiles, ()))
    profiles = (
        WrittenProfile(
            profile.name,
            profile.where,
            around,
            tuple((attachment.text, attachment.where) for attachment in profile.attachments),
        )
        for profile, around in nested
    )
    unused = ((tunable.name, tunable.where) for tunable in policy.unused_tunables)
    return PolicyStructure(tuple(profiles), _Clauses(nested), tuple(unused))


class _Clauses(Sequence[WrittenRule]):
    """The rules of nested profiles, made when they are first asked for: some analyses need the profiles alone."""

    def __init__(self, nested: Iterable[tuple[comarmor.Profile, _Around]]) -> None:
        self._nested = nested

    @cached_property
    def _made(self) -> tuple[WrittenRule, ...]:
        return tuple(
            WrittenRule(
                (*around, _texts(profile)),
                rule.with_expressions(attachment.text for attachment in rule.attachments),
                partial(_expand, rule),
                tuple(attachment.where for attachment in rule.attachments),
                len(rule.where.chain) > len(profile.where.chain),
            )
            for profile, around in self._nested
            for rule in profile.rules
        )

    def __getitem__(self, index: Any) -> Any:
        return self._made[index]

    def __iter__(self) -> Iterator[WrittenRule]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


def _nested(profiles: tuple[comarmor.Profile, ...], around: _Around) -> Iterator[tuple[comarmor.Profile, _Around]]:
    for profile in profiles:
        yield profile, around
        yield from _nested(profile.profiles, (*around, _texts(profile)))


def _texts(profile: comarmor.Profile) -> tuple[str, ...]:
    return tuple(attachment.text for attachment in profile.attachments)


def _expand(rule: comarmor.ProfileRule, namespace: str, name: str) -> tuple[str, ...]:
    return tuple(attachment.for_parts(namespace, name) for attachment in rule.attachments)
