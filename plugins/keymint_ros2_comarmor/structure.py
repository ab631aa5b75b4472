"""A ComArmor policy as it is written, for questions about subjects that it does not name."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import comarmor
from comarmor.errors import Origin
from comarmor.language.template import for_parts
from keymint.api import AttachedProfile, Clause, Structure
from keymint.ir import Rule

_Around = tuple[tuple[str, ...], ...]


def structure(
    policy: comarmor.Policy,
    origin: Callable[[comarmor.Origin], Origin],
    to_rule: Callable[[comarmor.Rule], Rule],
) -> Structure:
    """Return a policy as it is written.

    Args:
        policy: the policy.
        origin: returns a place as the intermediate representation has it.
        to_rule: returns a rule as the intermediate representation has it.
    """
    walked = tuple(_walked(policy.profiles, ()))
    profiles = (
        AttachedProfile(
            profile.name,
            origin(profile.where),
            around,
            tuple((attachment.text, origin(attachment.where)) for attachment in profile.attachments),
        )
        for profile, around in walked
    )
    clauses = (
        Clause(
            (*around, _texts(profile)),
            to_rule(rule),
            _expanding(rule),
            tuple(origin(attachment.where) for attachment in rule.attachments),
            len(rule.where.chain) > len(profile.where.chain),
        )
        for profile, around in walked
        for rule in profile.rules
    )
    unused = ((tunable.name, origin(tunable.where)) for tunable in policy.unused_tunables)
    return Structure(tuple(profiles), tuple(clauses), tuple(unused))


def _walked(profiles: tuple[comarmor.Profile, ...], around: _Around) -> Iterator[tuple[comarmor.Profile, _Around]]:
    for profile in profiles:
        yield profile, around
        yield from _walked(profile.profiles, (*around, _texts(profile)))


def _texts(profile: comarmor.Profile) -> tuple[str, ...]:
    return tuple(attachment.text for attachment in profile.attachments)


def _expanding(rule: comarmor.Rule) -> Callable[[str, str], tuple[str, ...]]:
    def expand(namespace: str, name: str) -> tuple[str, ...]:
        return tuple(
            for_parts(attachment.value, namespace, name) if attachment.value else attachment.text
            for attachment in rule.attachments
        )

    return expand
