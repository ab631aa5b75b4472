"""From the rules of a subject to the rules of a grant, in full and in the shortest form that means the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from comarmor.errors import Diagnostic, Severity
from comarmor.patterns.glob import Glob
from comarmor.patterns.printing import exact
from comarmor.patterns.relations import disjoint, sort_key
from comarmor.patterns.steps import StepLimitError, step_limit
from keymint.api import BuildOptions, Demand, Permissions
from keymint.errors import KeymintError
from keymint.ir import Rule
from keymint_ros2_dds.compiling import partitions
from keymint_ros2_dds.compiling.criteria import Criteria
from keymint_ros2_dds.compiling.gathering import GUARD, gathered
from keymint_ros2_dds.compiling.partitions import PartitionError
from keymint_ros2_dds.compiling.priority import Asked, prioritised
from keymint_ros2_dds.compiling.rules import Block, OrderError, blocks, one_by_one, standard_blocks
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.lowering.lower import Lowered, lower
from keymint_ros2_dds.lowering.mapping import Action, check_distro, knows
from keymint_ros2_dds.lowering.portable import InexpressibleError, spell

DIFFERING = "Cyclone DDS and Fast DDS"
STEPS = 4_000_000
"""Steps that putting the rules of a subject in order may take (:mod:`comarmor.patterns.steps`)."""


@dataclass(frozen=True, slots=True)
class Compiled:
    """The rules of a grant, and what is to be said of them.

    Attributes:
        forms: the rules, rewritten, the form that is liked best first: folded, gathered, and in order of priority.
        plain: the same in full: a rule for each rule of the policy, and nothing left out.
        lowered: what they are to mean.
        alike: every vendor reads them as the standard does.
        diagnostics: what is to be said of them.
    """

    forms: tuple[tuple[Criteria, ...], ...]
    plain: tuple[Criteria, ...]
    lowered: Lowered
    alike: bool
    diagnostics: tuple[Diagnostic, ...]


def compile_rules(permissions: Permissions, distro: str, options: BuildOptions) -> Compiled:
    """Compile the rules of a subject into rules that every vendor reads alike.

    Args:
        permissions: what the package asks for.
        distro: ROS 2 distribution whose mapping of names applies.
        options: ``allow_vendor_specific``: where vendors would differ, follow the standard and warn; ``demand``: what
            is asked for more often comes earlier.

    Raises:
        KeymintError: every rule that vendors would not read alike, with its ``file:line``.
    """
    check_distro(distro)
    lowered = lower(permissions.rules, distro)
    collector = _Collector(lowered, permissions.rules.subject, options.allow_vendor_specific)
    for action in Action:
        for pattern, reason in partitions.unsafe(lowered.allow[action]):
            collector.add("portability-partition", action, pattern, reason)
    folded = collector.written(_blocks(lowered, collector))
    if collector.problems and not options.allow_vendor_specific:
        raise KeymintError.of(collector.problems)
    plain = _plain(lowered, collector) if folded else ()
    rewritten = prioritised(gathered(folded), _asked(options.demand, distro))
    forms = (rewritten, folded) if rewritten != folded else (folded,)
    notes = (*lowered.diagnostics, *collector.problems)
    return Compiled(forms, plain, lowered, not collector.problems, notes)


def _blocks(lowered: Lowered, collector: _Collector) -> tuple[Block, ...]:
    if collector.problems:
        return standard_blocks(lowered)
    try:
        with step_limit(STEPS):
            return blocks(lowered)
    except OrderError as error:
        collector.add("portability-order", None, error.pattern, error.reason)
    except PartitionError as error:
        collector.add("portability-partition", None, error.pattern, error.reason)
    except StepLimitError as error:
        reason = (
            f"it overlaps with others in too many ways: no order of the rules was found within {error.steps:,} steps"
        )
        collector.add("portability-effort", None, _widest(lowered), reason)
    return standard_blocks(lowered)


def _widest(lowered: Lowered) -> Glob:
    """Return the pattern with the most wildcards, of several the first in order: one that is hard to put in order."""
    patterns = (pattern for sides in (lowered.allow, lowered.deny) for side in sides.values() for pattern, _ in side)
    return min(patterns, key=lambda pattern: (-sum(not isinstance(token, str) for token in pattern), sort_key(pattern)))


def _plain(lowered: Lowered, collector: _Collector) -> tuple[Criteria, ...]:
    """Return the rules with all their patterns, as they are written.

    Those that change nothing are left out where all are too many to order, or one of them is not read alike.
    """
    if collector.problems:
        return collector.written(one_by_one(standard_blocks(lowered), lowered))
    full = collector.of_its_own()
    try:
        with step_limit(STEPS):
            written = full.written(one_by_one(blocks(lowered, reduced=False), lowered))
    except (OrderError, PartitionError, StepLimitError):
        written = ()
    if written and not full.problems:
        return written
    return collector.written(one_by_one(blocks(lowered), lowered))


def _asked(demand: Iterable[Demand], distro: str) -> list[Asked]:
    """Return how often each endpoint is asked for."""
    found: Counter[tuple[str, str, str]] = Counter()
    for each in demand:
        if not knows(distro, each.edge.object.kind):
            continue  # nobody can ask for it there
        for endpoint in endpoints(distro, each.edge):
            for partition in endpoint.object.partitions or ("",):
                found[endpoint.permission, endpoint.object.name, partition] += each.times
    return [Asked(*key, times) for key, times in sorted(found.items())]


class _Collector:
    """Gathers what vendors would differ about, each once for each rule that a person wrote."""

    def __init__(self, lowered: Lowered, subject: str, warn: bool) -> None:
        self._lowered = lowered
        self._subject = subject
        self._severity = Severity.WARNING if warn else Severity.ERROR
        self._found: dict[tuple[str, Rule | None, str], Diagnostic] = {}

    @property
    def problems(self) -> tuple[Diagnostic, ...]:
        return tuple(self._found.values())

    def of_its_own(self) -> _Collector:
        """Return a collector that has found nothing yet."""
        return _Collector(self._lowered, self._subject, self._severity is Severity.WARNING)

    def add(self, code: str, action: Action | None, pattern: Glob, reason: str) -> None:
        rule = self._rule(action, pattern)
        where = rule.origin if rule else None
        if self._severity is Severity.WARNING:
            message = f"{reason}; the standard is followed, and {DIFFERING} may decide differently"
            hint = "see which names it concerns before you rely on it"
        else:
            message = reason
            hint = "write the names out, or build with --allow-vendor-specific"
        what = f"this {rule.effect} {rule.kind} rule cannot be said alike for all vendors: " if rule else ""
        diagnostic = Diagnostic(code, self._severity, what + message, where, hint, self._subject)
        self._found.setdefault((code, rule, reason), diagnostic)

    def written(self, found: Iterable[Block]) -> tuple[Criteria, ...]:
        """Return rules as they are written."""
        return tuple(Criteria(block.effect, block.partitions, dict(self._spelled(block))) for block in found)

    def _spelled(self, block: Block) -> Iterator[tuple[Action, tuple[str, ...]]]:
        """Yield the texts of the patterns of a rule, sorted, by action."""
        for action in Action:
            texts: set[str] = set()
            for pattern in block.topics.get(action, ()):
                try:
                    texts.update(spell(pattern))
                except InexpressibleError as error:
                    self.add("portability-expression", action, pattern, str(error))
                    texts.add(exact(pattern))
            if texts:
                yield action, tuple(sorted(texts))

    def _rule(self, action: Action | None, pattern: Glob) -> Rule | None:
        """Return the rule that a pattern comes from: the one that has it, else one that overlaps it."""
        actions = [action] if action else list(Action)
        entries = [
            item
            for sides in (self._lowered.deny, self._lowered.allow)
            for each in actions
            for item in sides[each].items()
        ]
        exact = (rule for (known, _), rule in entries if known == pattern)
        near = (rule for (known, _), rule in entries if not disjoint(known, pattern))
        return next(exact, None) or next(near, None)


def remarks(rules: Iterable[Criteria], permissions: Permissions) -> Iterator[Diagnostic]:
    """Yield what only some vendors do differently with the rules as they are written, once for a package."""
    subject = permissions.rules.subject
    rules = tuple(rules)
    if not rules:
        yield Diagnostic(
            "no-permissions", Severity.NOTE, f"{subject} is allowed nothing, and so it may not join a domain either",
            permissions.origin, "allow something if it is to take part", subject,
        )  # fmt: skip
    if any(Action.RELAY in rule.topics for rule in rules):
        yield Diagnostic(
            "vendor-relay", Severity.WARNING, "Cyclone DDS and OpenDDS ignore permissions to relay",
            permissions.origin, "do not rely on them there", subject,
        )  # fmt: skip
    written = {text for rule in rules for texts in rule.topics.values() for text in texts}
    infix = sorted(text for text in written - {GUARD} if "*" in text[:-1] or "[" in text)
    if infix:
        own = "; --no-optimise writes out the names that share one" if GUARD in written else ""
        yield Diagnostic(
            "vendor-wildcard", Severity.NOTE,
            f"OpenDDS and RTI Connext may not match a '*' before the end of an expression, or a bracket expression "
            f"({len(infix)} here, e.g. {infix[0]!r})",
            permissions.origin, f"Cyclone DDS and Fast DDS do{own}", subject,
        )  # fmt: skip
