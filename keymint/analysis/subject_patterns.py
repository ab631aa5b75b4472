# SPDX-License-Identifier: Apache-2.0
"""Patterns of subjects: which profiles and rules apply to them, and examples for them.

A subject's rules depend on the profiles that match it, and on its namespace and name through the placeholders
``{namespace}`` and ``{name}``. Rules for a pattern of subjects are over-approximated: they allow at least what the
policy allows to any of these subjects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from operator import itemgetter

from comarmor.patterns.decision_lists import Witness
from comarmor.patterns.glob import Glob, filled_text, literal, matches, normalise, parse, units
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.possible_names import matches_ros_name
from comarmor.patterns.relations import TooComplexError, covers, intersection
from comarmor.patterns.steps import StepLimitError, spend, step_counting_cache, step_limit
from comarmor.patterns.tokens import Charset, Star
from comarmor.rules import is_fully_qualified, is_subject
from comarmor.text import did_you_mean
from comarmor.values import Data
from keymint.api import LoadedPolicy, WrittenProfile, WrittenRule, lazy
from keymint.ir import Rule

# A run of the stages searches for no patterns.
_allow_only = lazy("keymint.analysis.rule_lists:allow_only")
_find_permitted = lazy("keymint.analysis.rule_lists:find_permitted")
_overlap = lazy("keymint.analysis.rule_lists:overlap")
_pattern_text = lazy("keymint.analysis.rule_lists:pattern_text")
ROOT_ENCLAVE = "/"
EVERY = parse("/*")
"""Matches every subject."""
_PREFERRED = "xyzabcdefghijklmnopqrstuvw0123456789_/ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_FILLINGS = ("x", "", "x/y", "/x", "x/", "_")
MOST_EXAMPLES = 400
_OVERLAPS = 1_000_000
"""Maximum steps of the search for overlapping patterns of subjects."""
_MOST_PIECES = 64
_NODE = "ros_parameter"


class SubjectClass(Data):
    """The subjects that one pattern matches and others do not.

    Attributes:
        like: the pattern that matches them.
        excluded: the patterns that do not.
    """

    like: Glob
    excluded: tuple[Glob, ...] = ()

    def __contains__(self, subject: str) -> bool:
        """Return whether a subject belongs to the class."""
        return matches(self.like, subject) and not any(matches(each, subject) for each in self.excluded)

    def overlaps(self, patterns: Iterable[Glob]) -> list[Glob]:
        """Return the overlaps of patterns with the class, without those that the class surely excludes."""
        pieces = (piece for one in patterns for piece in _overlap(self.like, one))
        return [piece for piece in pieces if not any(covers(each, piece) for each in self.excluded)]


def rules_of(policy: LoadedPolicy, subject: str) -> tuple[Rule, ...]:
    """Return the rules of a subject; none if no profile applies to it."""
    subject_rules = policy.rules(subject)
    return subject_rules.rules if subject_rules else ()


@step_counting_cache
def profile_subjects(profiles: tuple[tuple[str, ...], ...], within: Glob = EVERY) -> tuple[Glob, ...]:
    """Return patterns that together match exactly the subjects to which nested profiles apply.

    Args:
        profiles: expressions of each profile, outermost first.
        within: only subjects that match this pattern.

    Raises:
        TooComplexError: there are too many.
    """
    if not profiles:
        return (within,)
    return _narrowed(profile_subjects(profiles[:-1], within), profiles[-1])


def _narrowed(patterns: Iterable[Glob], level: Sequence[str]) -> tuple[Glob, ...]:
    """Return the intersections of patterns with the expressions of a profile."""
    attachments = [parse(expression) for expression in level]
    exact = {each for each in attachments if literal(each) is not None}
    wild = [each for each in attachments if literal(each) is None]
    new: dict[Glob, None] = {}
    for each in patterns:
        name = literal(each)
        if name is not None:
            if each in exact or any(matches(one, name) for one in wild):
                new[each] = None
            continue
        spend(len(attachments))
        new |= dict.fromkeys(one for one in attachments if one in exact and matches(each, literal(one) or ""))
        for one in wild:
            new |= dict.fromkeys(intersection(each, one))
        wildcards = sum(literal(each) is None for each in new) if len(new) > _MOST_PIECES else 0
        if wildcards > max(_MOST_PIECES, len(wild)):
            raise TooComplexError
    return tuple(new)


def can_exist(pattern: Glob) -> bool:
    """Return True unless no legal subject name matches a pattern."""
    return literal(pattern) == "/" or matches_ros_name(pattern)


def example_subject(pattern: Glob) -> str | None:
    """Return a subject that a pattern matches, or None if the search finds none."""
    name = literal(pattern)
    if name is not None:
        return name if is_subject(name) else None
    # Mostly the same text for all wildcards does.
    names = (_filled(pattern, each) for each in _FILLINGS)
    legal = next((name for name in names if is_fully_qualified(name) and matches(pattern, name)), None)
    if legal is not None:
        return legal
    outcome = _find_permitted(_NODE, _allow_only(pattern))
    return outcome.word if isinstance(outcome, Witness) else None


def pattern_examples(policy: LoadedPolicy, given_up: list[str] | None = None) -> dict[str, str]:
    """Return example subjects for the patterns that profiles match, and their overlaps: pattern by subject.

    Subjects that the policy names are left out. If rules depend on the subject's namespace, there is a second example
    in a deeper namespace. Empty if the policy type does not provide the structure.

    Args:
        policy: the policy.
        given_up: receives a text for each reason why a pattern may have no example.
    """
    written = policy.structure()
    if written is None:
        return {}
    wild: dict[Glob, None] = {}
    given_up = [] if given_up is None else given_up
    for profile in written.profiles:
        try:
            wild |= dict.fromkeys(one for one in profile_subjects(profile_chain(profile)) if literal(one) is None)
        except TooComplexError:
            given_up.append(f"the profiles around {profile.name!r} overlap in too many ways")
    examples: dict[str, str] = {}
    taken = set(policy.subjects())
    depends = bool(wild) and any(clause.expand("/a/", "a") != clause.expand("/b/", "b") for clause in written.clauses)
    for pattern in _with_overlaps(tuple(wild), given_up):
        example = example_subject(pattern)
        for subject in (example, _deeper(pattern, example) if depends and example else None):
            if subject is not None and subject not in taken:
                taken.add(subject)
                examples[subject] = _pattern_text(pattern)
    return examples


def _deeper(pattern: Glob, shallow: str) -> str | None:
    """Return a subject that a pattern matches, in a deeper namespace than its example, or None."""
    names = (_filled(pattern, filling) for filling in ("x/y", "/x/y", "x/y/", "/x/y/"))
    return next((name for name in names if is_fully_qualified(name) and name.count("/") > shallow.count("/")), None)


def _filled(pattern: Glob, filling: str) -> str:
    """Return a pattern with each star replaced by a text, and each set of characters by one of them."""
    return filled_text(pattern, filling, lambda members: next((char for char in _PREFERRED if char in members), ""))


def _with_overlaps(wild: Sequence[Glob], given_up: list[str]) -> list[Glob]:
    """Return patterns and the overlaps of two of them, up to :data:`MOST_EXAMPLES` overlaps."""
    places = {pattern: at for at, pattern in enumerate(wild)}
    found: dict[Glob, None] = {}  # overlaps that are neither of the two
    try:
        near = PatternIndex(places.items())
        with step_limit(_OVERLAPS):
            for at, one in enumerate(wild):
                before = sorted(((place, other) for other, place in near.meeting(one) if place < at), key=itemgetter(0))
                for _, other in before:
                    found |= dict.fromkeys(each for each in intersection(one, other) if each not in (one, other))
                if len(found) > 2 * MOST_EXAMPLES:
                    break
    except (StepLimitError, TooComplexError):
        given_up.append("patterns of subjects overlap in too many ways")
        return [*wild]
    overlaps = [each for each in found if each not in places]
    if len(overlaps) > MOST_EXAMPLES:
        given_up.append(f"more than {MOST_EXAMPLES} patterns of subjects overlap")
    return [*wild, *overlaps[:MOST_EXAMPLES]]


def expressions_for(clause: WrittenRule, subject: str) -> tuple[str, ...]:
    """Return the expressions of a rule for a subject."""
    return clause.expand(*_namespace_and_name(subject))


@lru_cache
def _namespace_and_name(subject: str) -> tuple[str, str]:
    """Return both parts of the name of a subject as expressions."""
    head, _, last = subject.rpartition("/")
    return _pattern_text((f"{head}/",)), _pattern_text((last,))


def fixed_expressions(clause: WrittenRule) -> tuple[str, ...]:
    """Return the expressions of a rule that do not depend on the subject."""
    variants = zip(clause.expand("/a/", "a"), clause.expand("/b/", "b"), strict=True)
    return tuple(one for one, other in variants if one == other)


def profile_chain(profile: WrittenProfile) -> tuple[tuple[str, ...], ...]:
    """Return the attachments of a profile and of the profiles around it, outermost first."""
    return (*profile.around, tuple(expression for expression, _ in profile.attachments))


def with_distinct_rules(subjects: Iterable[tuple[str, tuple[Rule, ...]]]) -> Iterator[tuple[str, tuple[Rule, ...]]]:
    """Yield subjects with their rules; of several subjects with identical rules only the first."""
    seen: dict[tuple[int, ...], tuple[Rule, ...]] = {}  # keeps the rules alive, so that ids are not reused
    for subject, rules in subjects:
        key = tuple(map(id, rules))
        if key not in seen:
            seen[key] = rules
            yield subject, rules


def namespace_name_splits(subjects: Glob) -> Iterator[tuple[Glob, Glob]]:
    """Yield pairs of patterns of namespace and name that together match the subjects of a pattern."""
    flat = units(subjects)
    for at, unit in enumerate(flat):
        rest = flat[at + 1 :]
        if "/" in rest:
            continue
        if unit == "/":
            yield normalise(flat[: at + 1]), normalise(rest)
        elif isinstance(unit, Star):
            yield normalise((*flat[: at + 1], "/")), normalise((unit, *rest))
        elif isinstance(unit, Charset) and "/" in unit:
            yield normalise((*flat[:at], "/")), normalise(rest)


def named_subjects(policy: LoadedPolicy, pattern: Glob) -> tuple[str, ...]:
    """Return the subject itself for an exact pattern, else the subjects that a policy names and the pattern matches."""
    exact = literal(pattern)
    return (exact,) if exact is not None else tuple(each for each in policy.subjects() if matches(pattern, each))


def unknown_subject(policy: LoadedPolicy, pattern: Glob) -> str:
    """Return a warning if a pattern is a single subject without a profile; else an empty text."""
    subject = literal(pattern)
    if subject is None or policy.rules(subject) is not None:
        return ""
    hint = did_you_mean(subject, policy.subjects())
    message = f"no profile of the policy applies to {subject}, so it has no permissions"
    return message + (f"; {hint}" if hint else "")


def representatives(policy: LoadedPolicy, pattern: Glob) -> tuple[str, ...]:
    """Return the subjects of :func:`named_subjects`, or if there are none an example for each profile."""
    named = named_subjects(policy, pattern)
    written = None if named else policy.structure()
    examples: dict[str, None] = {}
    for profile in written.profiles if written else ():
        chain = profile_chain(profile)
        try:
            reachable = [one for piece in intersection(pattern, EVERY) for one in profile_subjects(chain, piece)]
        except TooComplexError:
            continue
        examples |= dict.fromkeys(subject for one in reachable if (subject := example_subject(one)) is not None)
    return named or tuple(examples)
