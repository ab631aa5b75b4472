# SPDX-License-Identifier: Apache-2.0
"""Find likely mistakes in attachments that give a subject unintended rights: copied profiles and too wide wildcards.

Mistakes can look like intent, so the documented styles cause no warning: a profile for all subjects, a profile around
others, and profiles that list several subjects each.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

from comarmor.patterns.glob import Glob, literal, parse
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.patterns.tokens import STAR, Star
from comarmor.rules import Effect
from comarmor.text import first_few
from keymint.api import PolicyStructure, WrittenProfile, WrittenRule, lazy
from keymint.errors import Diagnostic

_undecided_note = lazy("keymint.analysis.findings:undecided_note")
_fixed_expressions = lazy("keymint.analysis.subject_patterns:fixed_expressions")
_profile_chain = lazy("keymint.analysis.subject_patterns:profile_chain")
STEPS = 2_000_000
"""Maximum steps of the search for subjects that a wildcard matches."""

_Texts = tuple[str, ...]
_Chain = tuple[_Texts, ...]


def attachment_mistakes(written: PolicyStructure) -> Iterator[Diagnostic]:
    """Yield warnings about likely mistakes, each cause once."""
    # A profile of a file that is included several times counts once.
    profiles = list({(each.where.spot, each.around): each for each in written.profiles}.values())
    by_name: dict[tuple[_Chain, str], WrittenProfile] = {}
    for each in profiles:
        other = by_name.setdefault((each.around, each.name), each)
        if other is not each:
            yield Diagnostic.warning(
                "profile-name-twice",
                f"two profiles are named {each.name!r}, the other one at {other.where.alone()}; both apply",
                each.where,
                "rename one, or merge them; if one is a copy with an unchanged attachment, it gives its rights to the "
                "subjects of the other",
            )
    # Profiles of one file with the same exact attachments; another file may extend a profile.
    by_attachments: dict[tuple[_Chain, str, frozenset[str]], WrittenProfile] = {}
    for each in profiles:
        texts = frozenset(_texts(each))
        if any(literal(parse(text)) is None for text in texts):
            continue
        other = by_attachments.setdefault((each.around, each.where.file, texts), each)
        if other is not each and other.name != each.name:
            yield Diagnostic.warning(
                "profile-copied",
                f"the profiles {other.name!r} ({other.where.alone()}) and {each.name!r} are both attached to "
                f"{first_few(sorted(texts), 3)}, which gets the rights of both",
                each.where,
                "fix the attachment of the copy, or merge the profiles",
            )
    yield from _wide(profiles, written.clauses)


_GrantedRight = tuple[str, str]
"""Permission and expression of a rule in the profile itself."""
_Rights = Mapping[_Chain, Mapping[_GrantedRight, None]]


def _wide(profiles: Sequence[WrittenProfile], clauses: Iterable[WrittenRule]) -> Iterator[Diagnostic]:
    """Yield profiles whose wildcards match subjects that have a profile of their own beside it."""
    attached = [(each, text, parse(text)) for each in profiles for text in _texts(each)]
    wild = [(each, text, glob) for each, text, glob in attached if literal(glob) is None and not _is_for_all(glob)]
    if not wild:
        return
    rights = _rights(clauses)
    near = PatternIndex((glob, each) for each, _, glob in attached if literal(glob) is not None)
    checked: set[tuple[_Chain, str]] = set()
    for each, text, glob in wild:
        chain = _profile_chain(each)
        if not rights.get(chain) or (chain, text) in checked:
            continue
        checked.add((chain, text))
        try:
            with step_limit(STEPS):
                gaining = list(_gaining(each, near.meeting(glob), rights))
        except StepLimitError as limit:
            yield _undecided_note(
                f"the subjects that profile {each.name!r} gets by {text!r} are unknown: {limit}",
                "attach it to fewer subjects, or lint parts of the policy",
                each.where,
            )
            continue
        if gaining:
            subject, own, (permission, expression) = gaining[0]
            more = f" and {len(gaining) - 1:,} more" if len(gaining) > 1 else ""
            yield Diagnostic.warning(
                "profile-wide",
                f"profile {each.name!r} applies to {subject}{more} by {text!r}, and gives rights that its own profile "
                f"{own.name!r} ({own.where.alone()}) does not have, e.g. {permission} on {expression!r}",
                each.where,
                f"if intended, nest profile {own.name!r} in profile {each.name!r}, or move common rules to a file that "
                "both include; else attach it to the intended subjects only",
            )


def _gaining(
    wide: WrittenProfile, near: Iterable[tuple[Glob, WrittenProfile]], rights: _Rights
) -> Iterator[tuple[str, WrittenProfile, _GrantedRight]]:
    """Yield subjects that gain rights by a wide profile, each once, with their own profile and such a right."""
    granted = rights[_profile_chain(wide)]
    own: dict[str, list[WrittenProfile]] = defaultdict(list)
    for glob, profile in near:
        # Only siblings: for nested profiles, the outer ones are checked.
        if profile.around == wide.around and set(_texts(profile)).isdisjoint(_texts(wide)):
            own[literal(glob) or ""].append(profile)
    for subject, its_profiles in own.items():
        existing = {right for each in its_profiles for right in rights.get(_profile_chain(each), {})}
        missing = next((right for right in granted if right not in existing), None)
        if missing is not None:
            yield subject, its_profiles[0], missing


def _rights(clauses: Iterable[WrittenRule]) -> _Rights:
    """Return the rights by rules in each profile itself whose expressions do not depend on the subject.

    Expressions that depend on the subject, and included rules, are meant for several subjects.
    """
    rights: dict[_Chain, dict[_GrantedRight, None]] = defaultdict(dict)
    for clause in clauses:
        rule = clause.rule
        if rule.effect is not Effect.ALLOW or clause.included:
            continue
        for expression in _fixed_expressions(clause):
            rights[clause.profiles] |= dict.fromkeys((permission, expression) for permission in rule.permissions)
    return rights


def _is_for_all(pattern: Glob) -> bool:
    """Return True for an attachment to every subject, or to every subject of some name in any namespace."""
    return isinstance(pattern[0], Star) or pattern == ("/", STAR)


def _texts(profile: WrittenProfile) -> _Texts:
    return tuple(text for text, _ in profile.attachments)
