"""The permissions document: a grant for one subject (DDS Security 1.1, 9.4.1.3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from lxml import etree

from keymint.api import Permissions
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.ir import Effect, Rule
from keymint.keymake.algebra import disjoint
from keymint.keymake.glob import Glob
from keymint.pki import names
from keymint_ros2_dds import document, partitions
from keymint_ros2_dds.lower import Lowered, Partitions, lower
from keymint_ros2_dds.mapping import Action, check_distro
from keymint_ros2_dds.partitions import DEFAULT, PartitionError
from keymint_ros2_dds.rules import Block, OrderError, blocks, standard_blocks
from keymint_ros2_dds.spelling import InexpressibleError, faithful, spell

DIFFERING = "Cyclone DDS and Fast DDS"


@dataclass(frozen=True, slots=True)
class Criteria:
    """The rules of a grant as they are written: texts only."""

    effect: Effect
    partitions: Partitions
    topics: Mapping[Action, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Compiled:
    """The rules of a grant, and what is to be said of them."""

    rules: tuple[Criteria, ...]
    lowered: Lowered
    diagnostics: tuple[Diagnostic, ...]


def compile_rules(permissions: Permissions, distro: str, *, allow_vendor_specific: bool) -> Compiled:
    """Compile the rules of a subject into rules that every vendor reads alike.

    Args:
        permissions: what the package asks for.
        distro: ROS 2 distribution whose mapping of names applies.
        allow_vendor_specific: where vendors would differ, follow the standard and warn.

    Raises:
        KeymintError: every rule that vendors would not read alike, with its ``file:line``.
    """
    check_distro(distro)
    lowered = lower(permissions.rules, distro)
    collector = _Collector(lowered, permissions.rules.subject, allow_vendor_specific)
    for action in Action:
        for pattern, reason in partitions.unsafe(lowered.allow[action]):
            collector.add("portability-partition", action, pattern, reason)
    found = _blocks(lowered, collector)
    rules = tuple(Criteria(block.effect, block.partitions, dict(collector.spelled(block))) for block in found)
    if collector.problems and not allow_vendor_specific:
        raise KeymintError.of(collector.problems)
    notes = (*lowered.diagnostics, *collector.problems, *_remarks(rules, permissions))
    return Compiled(rules, lowered, notes)


def _blocks(lowered: Lowered, collector: _Collector) -> tuple[Block, ...]:
    if collector.problems:
        return standard_blocks(lowered)
    try:
        return blocks(lowered)
    except OrderError as error:
        collector.add("portability-order", None, error.pattern, error.reason)
    except PartitionError as error:
        collector.add("portability-partition", None, error.pattern, error.reason)
    return standard_blocks(lowered)


class _Collector:
    """Gathers what vendors would differ about, each once for each rule that a person wrote."""

    def __init__(self, lowered: Lowered, subject: str, warn: bool) -> None:
        self._lowered = lowered
        self._subject = subject
        self._severity = Severity.WARNING if warn else Severity.ERROR
        self._found: dict[tuple[str, Origin | None, str], Diagnostic] = {}

    @property
    def problems(self) -> tuple[Diagnostic, ...]:
        return tuple(self._found.values())

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
        self._found.setdefault((code, where, reason), diagnostic)

    def spelled(self, block: Block) -> Iterator[tuple[Action, tuple[str, ...]]]:
        """Yield the texts of the patterns of a rule, sorted, by action."""
        for action in Action:
            texts: set[str] = set()
            for pattern in block.topics.get(action, ()):
                try:
                    texts.update(spell(pattern))
                except InexpressibleError as error:
                    self.add("portability-expression", action, pattern, str(error))
                    texts.add(faithful(pattern))
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


def _remarks(rules: Iterable[Criteria], permissions: Permissions) -> Iterator[Diagnostic]:
    """Yield what only some vendors do differently, once for a package."""
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
    infix = sorted(
        {text for rule in rules for texts in rule.topics.values() for text in texts if "*" in text[:-1] or "[" in text}
    )
    if infix:
        yield Diagnostic(
            "vendor-wildcard", Severity.NOTE,
            f"OpenDDS and RTI Connext may not match a '*' before the end of an expression, or a bracket expression "
            f"({len(infix)} here, e.g. {infix[0]!r})",
            permissions.origin, "Cyclone DDS and Fast DDS do", subject,
        )  # fmt: skip


def render(permissions: Permissions, rules: Iterable[Criteria]) -> bytes:
    """Return the permissions document, valid against its schema; a pure function of its arguments.

    Raises:
        KeymintError: the subject's name, a date or a domain cannot be said alike for all vendors.
    """
    subject = permissions.rules.subject
    problems = document.check_domains(permissions.domains, permissions.origin, subject)
    if permissions.validity.not_after.year > document.MAX_YEAR:
        message = (
            f"the permissions end in the year {permissions.validity.not_after.year}, which Cyclone DDS takes to be over"
        )
        help_ = f"let them end by {document.MAX_YEAR}"
        problems.append(Diagnostic("portability-date", Severity.ERROR, message, permissions.origin, help_, subject))
    if problems:
        raise KeymintError.of(problems)
    root = document.root(document.PERMISSIONS)
    grant = document.child(document.child(root, "permissions"), "grant")
    grant.set("name", permissions.grant_name)
    document.child(grant, "subject_name", names.render(names.parse(permissions.subject_name, permissions.origin)))
    validity = document.child(grant, "validity")
    document.child(validity, "not_before", document.date(permissions.validity.not_before))
    document.child(validity, "not_after", document.date(permissions.validity.not_after))
    for rule in rules:
        element = document.child(grant, "allow_rule" if rule.effect is Effect.ALLOW else "deny_rule")
        document.domains(element, permissions.domains)
        for action, texts in rule.topics.items():
            _criteria(element, action, texts, rule.partitions)
    document.child(grant, "default", "DENY")
    return document.render(root, document.PERMISSIONS)


def _criteria(parent: etree._Element, action: Action, texts: Iterable[str], listed: Partitions) -> None:
    element = document.child(parent, action)
    topics = document.child(element, "topics")
    for text in texts:
        document.child(topics, "topic", text)
    if listed != DEFAULT:
        names_ = document.child(element, "partitions")
        for text in listed:
            document.child(names_, "partition", text)
