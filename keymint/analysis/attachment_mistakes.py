"""Slips in how profiles are attached, which give rights to a subject without a word: copies, and wildcards too wide.

What is meant and what is a slip look alike. So there is no warning about the ways that the documentation
shows: a profile for all subjects, a profile around others, and profiles that list several subjects each.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from comarmor.errors import Diagnostic, Severity
from comarmor.patterns.glob import Glob, literal, parse
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.patterns.tokens import Star
from comarmor.rules import Effect
from keymint.api import PolicyStructure, WrittenProfile, WrittenRule

STEPS = 2_000_000
"""Steps that the search for subjects that a wildcard matches may take."""

CODES: Mapping[str, str] = {
    "profile-name-twice": "Two profiles side by side have the same name.",
    "profile-copied": "Two profiles side by side are attached to the same subjects.",
    "profile-wide": "A wildcard gives rights to a subject that has a profile of its own.",
}
"""The findings of this room, each with one line that says what it means."""

_Texts = tuple[str, ...]
_Chain = tuple[_Texts, ...]


def attachment_mistakes(written: PolicyStructure) -> Iterator[Diagnostic]:
    """Yield what is likely a slip, each cause once.

    Args:
        written: a policy.
    """
    # A file that is included several times has its profiles once.
    profiles = list({(each.where.spot, each.around): each for each in written.profiles}.values())
    yield from _named_twice(profiles)
    yield from _copied(profiles)
    yield from _wide(profiles, written.clauses)


def _named_twice(profiles: Iterable[WrittenProfile]) -> Iterator[Diagnostic]:
    first: dict[tuple[_Chain, str], WrittenProfile] = {}
    for each in profiles:
        other = first.setdefault((each.around, each.name), each)
        if other is not each:
            yield _said(
                "profile-name-twice",
                f"two profiles are named {each.name!r}, the other one at {other.where.alone()}; both count",
                each,
                "give each a name of its own, or make one of them; a copy whose attachment was not changed gives its "
                "rights to the subjects of the other",
            )


def _copied(profiles: Iterable[WrittenProfile]) -> Iterator[Diagnostic]:
    """Yield profiles of one file with the same exact attachments; another file may add to what one says."""
    first: dict[tuple[_Chain, str, frozenset[str]], WrittenProfile] = {}
    for each in profiles:
        texts = frozenset(_texts(each))
        if not all(literal(parse(text)) is not None for text in texts):
            continue
        other = first.setdefault((each.around, each.where.file, texts), each)
        if other is not each and other.name != each.name:  # equal names are reported already
            yield _said(
                "profile-copied",
                f"the profiles {other.name!r} ({other.where.alone()}) and {each.name!r} are both attached to "
                f"{_listed(sorted(texts))}, who has the rights of both",
                each,
                "mend the attachment of the copy, or make one profile of them",
            )


@dataclass(frozen=True, slots=True)
class _Right:
    """What a rule of a profile itself allows: kind, permission, and the expression as it is written."""

    kind: str
    permission: str
    expression: str


def _wide(profiles: Sequence[WrittenProfile], clauses: Iterable[WrittenRule]) -> Iterator[Diagnostic]:
    """Yield profiles whose wildcards match subjects with a profile of their own that is not inside of them."""
    wild = [(each, text, parse(text)) for each in profiles for text in _texts(each)]
    wild = [(each, text, glob) for each, text, glob in wild if literal(glob) is None and not _is_for_all(glob)]
    if not wild:
        return
    rights = _rights(clauses)
    near = PatternIndex(
        (parse(text), each) for each in profiles for text in _texts(each) if literal(parse(text)) is not None
    )
    told: set[tuple[_Chain, str]] = set()
    for each, text, glob in wild:
        granted = rights.get(_chain(each), {})
        if not granted or (_chain(each), text) in told:
            continue
        told.add((_chain(each), text))
        try:
            with step_limit(STEPS):
                gaining = list(_gaining(each, granted, near.meeting(glob), rights))
        except StepLimitError as spent:
            yield Diagnostic(
                "lint-unknown",
                Severity.NOTE,
                f"whom profile {each.name!r} applies to by {text!r} was {spent}",
                each.where,
                "attach it to fewer subjects, or lint parts of the policy",
            )
            continue
        if gaining:
            subject, own, right = gaining[0]
            more = f" and {len(gaining) - 1:,} more" if len(gaining) > 1 else ""
            yield _said(
                "profile-wide",
                f"profile {each.name!r} applies to {subject}{more} by {text!r}, and gives rights that its own profile "
                f"{own.name!r} ({own.where.alone()}) does not have, e.g. {right.permission} on {right.expression!r}",
                each,
                f"if that is meant, put profile {own.name!r} into profile {each.name!r}, or what is common into a file "
                "that both include; else attach it to the subjects that are meant",
            )


def _gaining(
    wide: WrittenProfile,
    granted: Mapping[_Right, None],
    near: Iterable[tuple[Glob, WrittenProfile]],
    rights: Mapping[_Chain, Mapping[_Right, None]],
) -> Iterator[tuple[str, WrittenProfile, _Right]]:
    """Yield subjects, each once, that gain by a wide profile, with their own profile and a right that they gain."""
    chain = _chain(wide)
    own: dict[str, list[WrittenProfile]] = defaultdict(list)
    for glob, profile in near:
        # Only beside: of what stands inside of other profiles, these are the ones to be looked at.
        if profile.around == wide.around and _texts(profile) != chain[-1] and not _texts_meet(profile, wide):
            own[literal(glob) or ""].append(profile)
    for subject, listed in own.items():
        held = {right: None for each in listed for right in rights.get(_chain(each), {})}
        missing = next((right for right in granted if right not in held), None)
        if missing is not None:
            yield subject, listed[0], missing


def _texts_meet(profile: WrittenProfile, wide: WrittenProfile) -> bool:
    """Tell whether a profile is attached by a wildcard of the other one as well: then it is about the same subjects."""
    return not set(_texts(profile)).isdisjoint(_texts(wide))


def _rights(clauses: Iterable[WrittenRule]) -> dict[_Chain, dict[_Right, None]]:
    """Return what the rules of each profile allow that stand in the profile itself and name objects for themselves.

    What depends on the subject, and what is included, is meant for several subjects.
    """
    found: dict[_Chain, dict[_Right, None]] = defaultdict(dict)
    for clause in clauses:
        rule = clause.rule
        if rule.effect is not Effect.ALLOW or clause.included:
            continue
        texts = zip(clause.expand("/a/", "a"), clause.expand("/b/", "b"), strict=True)
        for expression in (one for one, other in texts if one == other):
            found[clause.profiles] |= dict.fromkeys(_Right(rule.kind, held, expression) for held in rule.permissions)
    return found


def _is_for_all(pattern: Glob) -> bool:
    """Tell whether an attachment is for every subject, or for every one of some name, in whatever namespace."""
    return isinstance(pattern[0], Star) or pattern == ("/", Star())


def _chain(profile: WrittenProfile) -> _Chain:
    return (*profile.around, _texts(profile))


def _texts(profile: WrittenProfile) -> _Texts:
    return tuple(text for text, _ in profile.attachments)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (", …" if len(names) > 3 else "")  # noqa: PLR2004 - as many as a line takes


def _said(code: str, message: str, profile: WrittenProfile, help_: str) -> Diagnostic:
    return Diagnostic(code, Severity.WARNING, message, profile.where, help_)
