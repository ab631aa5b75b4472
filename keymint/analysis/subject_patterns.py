"""Subjects that a policy does not name: which rules reach them, and whom to take as an example.

A subject's rules depend on the profiles that match it, and on its namespace and name where ``{namespace}`` and
``{name}`` stand for them. What is said here of a whole pattern of subjects errs on one side only: it permits at least
what the policy permits to any of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter

from comarmor.patterns.decision_lists import Block, DecisionList, Equal
from comarmor.patterns.glob import Glob, literal, normalise, parse, units
from comarmor.patterns.matching import matches
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.proofs import difference
from comarmor.patterns.relations import TooComplexError, covers, intersection
from comarmor.patterns.steps import StepLimitError, cached, spend, step_limit
from comarmor.patterns.tokens import Charset, Star
from comarmor.ros_names import is_fully_qualified
from comarmor.rules import Effect
from comarmor.text import did_you_mean
from keymint.analysis.rule_lists import (
    PermissionKey,
    allowed,
    decisions,
    keys,
    names,
    patterns,
    text,
    universe,
)
from keymint.api import LoadedPolicy, PolicyStructure, StructuredPolicy, WrittenRule
from keymint.ir import Rule

EVERY = parse("/*")
"""What every subject matches."""
_PREFERRED = "xyzabcdefghijklmnopqrstuvw0123456789_/ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_FILLINGS = ("x", "", "x/y", "/x", "x/", "_")
_MOST_EXAMPLES = 400
_OVERLAPS = 1_000_000
"""Steps that the search for patterns of subjects that overlap may take."""
_MOST_PIECES = 64
_NODE = "ros_parameter"


def structure(policy: LoadedPolicy) -> PolicyStructure | None:
    """Return the profiles of a policy as written, or None if its type does not offer them."""
    return policy.structure() if isinstance(policy, StructuredPolicy) else None


def rules_of(policy: LoadedPolicy, subject: str) -> tuple[Rule, ...]:
    """Return the rules of a subject; none when no profile applies to it."""
    found = policy.rules(subject)
    return found.rules if found else ()


@cached(1 << 14)
def profile_subjects(profiles: tuple[tuple[str, ...], ...], within: Glob = EVERY) -> tuple[Glob, ...]:
    """Return patterns that together match the subjects to which nested profiles apply.

    Args:
        profiles: expressions of each profile, outermost first.
        within: only subjects that this matches.

    Raises:
        TooComplexError: there are too many.
    """
    if not profiles:
        return (within,)
    return _narrowed(profile_subjects(profiles[:-1], within), profiles[-1])


def _narrowed(found: Iterable[Glob], level: Sequence[str]) -> tuple[Glob, ...]:
    """Return patterns that match what others match, as far as an expression of a profile does so, too."""
    wanted = [parse(expression) for expression in level]
    exact = {each for each in wanted if literal(each) is not None}
    wild = [each for each in wanted if literal(each) is None]
    new: dict[Glob, None] = {}
    for each in found:
        name = literal(each)
        if name is not None:
            if each in exact or any(matches(one, name) for one in wild):
                new[each] = None
            continue
        spend(len(wanted))
        new |= dict.fromkeys(one for one in wanted if one in exact and matches(each, literal(one) or ""))
        for one in wild:
            new |= dict.fromkeys(intersection(each, one))
        wildcards = sum(literal(each) is None for each in new) if len(new) > _MOST_PIECES else 0
        if wildcards > max(_MOST_PIECES, len(wild)):
            raise TooComplexError
    return tuple(new)


def can_exist(pattern: Glob) -> bool:
    """Tell whether a subject can have a name that a pattern matches; True where that is not decided."""
    if _filled_legally(pattern) is not None:
        return True
    found = difference((), allowed(pattern), names(_NODE), universe=universe(_NODE))
    return not isinstance(found, Equal)


def _filled_legally(pattern: Glob) -> str | None:
    """Return a legal name that a pattern matches, with one text for all its wildcards; None where none is seen."""
    name = literal(pattern)
    if name is not None:
        return name if is_fully_qualified(name) else None
    filled = (_filled(pattern, each) for each in _FILLINGS)
    return next((name for name in filled if is_fully_qualified(name) and matches(pattern, name)), None)


def example(pattern: Glob) -> str | None:
    """Return a subject that a pattern matches, or None when none is found."""
    filled = _filled_legally(pattern)
    if filled is not None or literal(pattern) is not None:
        return filled
    found = difference((), allowed(pattern), names(_NODE), universe=universe(_NODE))
    return getattr(found, "word", None)


def _member(members: Charset) -> str:
    return next((char for char in _PREFERRED if char in members), "")


def examples(
    structures: Sequence[PolicyStructure], known: Iterable[str], given_up: list[str] | None = None
) -> dict[str, str]:
    """Return subjects for each class of subjects that profiles match by a pattern: pattern by subject.

    Where rules depend on the subject's namespace there is one in a namespace below as well.

    Args:
        structures: policies as they are written.
        known: subjects that need no example.
        given_up: gets a text for each reason why there may be classes without an example.
    """
    wild: dict[Glob, None] = {}
    given_up = [] if given_up is None else given_up
    for each in structures:
        for profile in each.profiles:
            chain = (*profile.around, tuple(expression for expression, _ in profile.attachments))
            try:
                wild |= dict.fromkeys(one for one in profile_subjects(chain) if literal(one) is None)
            except TooComplexError:
                given_up.append(f"the profiles around {profile.name!r} overlap in too many ways")
    found: dict[str, str] = {}
    taken = set(known)
    depends = any(_depends(clause) for each in structures for clause in each.clauses)
    for pattern in _with_overlaps(tuple(wild), given_up):
        for subject in (example(pattern), _deeper(pattern) if depends else None):
            if subject is not None and subject not in taken:
                taken.add(subject)
                found[subject] = text(pattern)
    return found


def _depends(clause: WrittenRule) -> bool:
    """Tell whether a rule is about other objects for another subject."""
    return clause.expand("/a/", "a") != clause.expand("/b/", "b")


def _deeper(pattern: Glob) -> str | None:
    """Return a subject that a pattern matches in a namespace below that of its example, or None."""
    shallow = example(pattern)
    if shallow is None or not any(isinstance(token, Star) for token in pattern):
        return None
    depth = shallow.count("/")
    legal = (
        name for filling in ("x/y", "/x/y", "x/y/", "/x/y/") if is_fully_qualified(name := _filled(pattern, filling))
    )
    return next((name for name in legal if name.count("/") > depth), None)


def _filled(pattern: Glob, filling: str) -> str:
    """Return a pattern with each star, and each set of characters, replaced."""
    return "".join(
        filling if isinstance(token, Star) else token if isinstance(token, str) else _member(token) for token in pattern
    )


def pattern_examples(policy: LoadedPolicy, given_up: list[str] | None = None) -> dict[str, str]:
    """Return a subject for each class of those that a policy does not name; see :func:`examples`."""
    written = structure(policy)
    return examples([written], policy.subjects(), given_up) if written else {}


def _with_overlaps(wild: Sequence[Glob], given_up: list[str]) -> Iterator[Glob]:
    """Yield patterns, and what two of them have in common, up to a number."""
    yield from wild
    reason = f"more than {_MOST_EXAMPLES} patterns of subjects overlap"
    left = _MOST_EXAMPLES
    known = set(wild)
    try:
        for each in _overlaps(wild):
            if each not in known:
                known.add(each)
                if not left:
                    given_up.append(reason)
                    return
                left -= 1
                yield each
    except (StepLimitError, TooComplexError):
        given_up.append("patterns of subjects overlap in too many ways")


def _overlaps(wild: Sequence[Glob]) -> list[Glob]:
    """Return what two patterns have in common, as far as that is an overlap of its own.

    Raises:
        EffortError: there are too many patterns with the same beginning.
        TooComplexError: two patterns overlap in too many ways.
    """
    places = {pattern: at for at, pattern in enumerate(wild)}
    near = PatternIndex(places.items())
    found: dict[Glob, None] = {}
    with step_limit(_OVERLAPS):
        for at, one in enumerate(wild):
            before = sorted(((place, other) for other, place in near.meeting(one) if place < at), key=itemgetter(0))
            for _, other in before:
                found |= dict.fromkeys(each for each in intersection(one, other) if each not in (one, other))
            if len(found) > 2 * _MOST_EXAMPLES:
                break
    return list(found)


def at_most(found: PolicyStructure, within: Glob, key: PermissionKey) -> Iterator[tuple[Glob, DecisionList]]:
    """Yield, for patterns of subjects, a list that permits at least what any subject of that pattern may do.

    Args:
        found: a policy as it is written.
        within: the subjects in question.
        key: a kind, and a permission without parts.

    Raises:
        TooComplexError: the subjects cannot be told apart within bounds.
    """
    about = [clause for clause in found.clauses if key in keys(clause.rule)]
    denials = [clause for clause in about if clause.rule.effect is Effect.DENY]
    for clause in about:
        if clause.rule.effect is not Effect.ALLOW:
            continue
        for subjects in profile_subjects(clause.profiles, within):
            granted: dict[Glob, None] = {}
            for namespace, name in namespace_name_splits(subjects):
                for expression in clause.expand(text(namespace), text(name)):
                    granted |= dict.fromkeys(patterns(clause.rule, expression, key))
            yield subjects, decisions(_surely_denied(denials, subjects, key), granted)


def _surely_denied(denials: Sequence[WrittenRule], subjects: Glob, key: PermissionKey) -> Iterator[Glob]:
    """Yield what is denied to every subject that a pattern matches."""
    for clause in denials:
        if not any(covers(each, subjects) for each in profile_subjects(clause.profiles)):
            continue
        name = literal(subjects)
        if name is not None:
            head, _, last = name.rpartition("/")
            surely = clause.expand(text((f"{head}/",)), text((last,)))
        else:
            surely = tuple(
                one
                for one, other in zip(clause.expand("/a/", "a"), clause.expand("/b/", "b"), strict=True)
                if one == other
            )
        for expression in surely:
            yield from patterns(clause.rule, expression, key)


def namespace_name_splits(subjects: Glob) -> Iterator[tuple[Glob, Glob]]:
    """Yield patterns of namespace and name so that each subject that a pattern matches is of one of them."""
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


def matching(policy: LoadedPolicy, pattern: Glob) -> tuple[str, ...]:
    """Return the subjects that a policy names exactly and a pattern matches."""
    return tuple(subject for subject in policy.subjects() if matches(pattern, subject))


def unknown_subject(policy: LoadedPolicy, pattern: Glob) -> str:
    """Return why a subject may not be the one that was meant; empty for a pattern, and for one of the policy's."""
    subject = literal(pattern)
    if subject is None or policy.rules(subject) is not None:
        return ""
    hint = did_you_mean(subject, policy.subjects())
    said = f"no profile of the policy applies to {subject}, so that it may do nothing"
    return said + (f"; {hint}" if hint else "")


def representatives(policy: LoadedPolicy, pattern: Glob) -> tuple[str, ...]:
    """Return the subject that a pattern is, or those that a policy names, or else an example for each profile."""
    exact = literal(pattern)
    named = (exact,) if exact is not None else matching(policy, pattern)
    written = None if named else structure(policy)
    found: dict[str, None] = {}
    for profile in written.profiles if written else ():
        chain = (*profile.around, tuple(expression for expression, _ in profile.attachments))
        try:
            reachable = [one for piece in intersection(pattern, EVERY) for one in profile_subjects(chain, piece)]
        except TooComplexError:
            continue
        found |= dict.fromkeys(subject for one in reachable if (subject := example(one)) is not None)
    return named or tuple(found)


def only(pattern: Glob, decided: DecisionList) -> DecisionList:
    """Return a list that permits what another one permits, of what a pattern matches; the pattern is one of its own."""
    return (*(block for block in decided if not block.allows), Block(True, (pattern,)))
