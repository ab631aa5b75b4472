# SPDX-License-Identifier: Apache-2.0
"""The structure of a ComArmor policy as it is written, for analyses of subjects that it does not name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property, lru_cache, partial
from typing import Any

import comarmor
from keymint.api import PolicyStructure, WrittenProfile, WrittenRule

_Around = tuple[tuple[str, ...], ...]


@lru_cache(maxsize=4)
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
