# SPDX-License-Identifier: Apache-2.0
"""Emits the permissions document of a subject by its kind.

It is renamed from that of another member, which the engine made, where that is proven to be the same: the structure of
a kind says which DDS names a subject puts into it, and what must be alike for two subjects to have alike documents.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain, combinations, product

from comarmor.patterns.glob import Glob, literal, matcher, parse, regex
from comarmor.patterns.relations import TooComplexError, intersection
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.patterns.tokens import ANY, Charset
from comarmor.rules import is_fully_qualified
from comarmor.text import lazy_regex
from comarmor.values import Data, field
from keymint.api import BuildOptions, Claim, DomainRange, Grant, Package, Validity
from keymint.errors import KeymintError
from keymint.ir import Arguments, Kind
from keymint_ros2_dds.compiling.grant_compiler import vendor_notes
from keymint_ros2_dds.compiling.rewriting import gathered_rules
from keymint_ros2_dds.decision.semantics import VARIATIONS
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.emit.emission import Emitted, comparison, emit
from keymint_ros2_dds.enclave_layout import PERMISSIONS
from keymint_ros2_dds.lowering.lowered_rules import GrantRule, is_name
from keymint_ros2_dds.lowering.name_mapping import ARDENT, dds_patterns, needed_topics
from keymint_ros2_dds.proving import claims
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant
from keymint_ros2_dds.settings import validity_of
from keymint_ros2_dds.subject_names import is_usual, subject_name_of
from keymint_ros2_dds.vendor_limits import TIGHT, signed_size

MOST_WILDCARDS = 64
"""Wildcards of a kind: the engine takes subjects with more."""
STEPS = 20_000
"""Steps to intersect these (:mod:`comarmor.patterns.steps`)."""

PLAIN_TEXT = lazy_regex(r"[!#-%'-);=@-Z^-~,-:+]+")
"""Text that every parser and model reads as itself: printable ASCII, without blanks, wildcards, brackets and markup."""

MOST_SHORT = 200
"""Names that may be too short for an expression that is renamed (:func:`_relations`)."""
MOST_LETTERS = 100
"""Length of an expression that is renamed, so that the engine takes few steps to compare two."""

Slot = tuple[str, int, str]
"""A DDS name or expression of a kind: a text, the number of an argument, and a text."""
Signature = tuple[tuple[int, ...], tuple[int, ...], bytes]
"""Which names are equal, which wildcards match which of them, as bits, and how wildcards that differ are related."""
Ends = tuple[tuple[str, str], ...]
"""The texts before and after the ``*`` of DDS expressions."""


class Structure(Data):
    """The DDS names and wildcards of a kind.

    Attributes:
        slots: the names.
        ros: numbers of the arguments that must be ROS names.
        own: the expressions with a ``*``, if each member has others.
        wildcards: else the patterns of the policy, and the intersections of any two.
    """

    slots: tuple[Slot, ...]
    ros: frozenset[int]
    own: tuple[Slot, ...]
    wildcards: tuple[Glob, ...]
    _any: re.Pattern[str]

    @classmethod
    def of(cls, kind: Kind, arguments: Arguments, distro: str) -> Structure | None:
        """Return the structure of a kind; None if its documents depend on more than :meth:`fit` tells.

        Args:
            kind: the kind.
            arguments: of a member. All have the same wildcards, or all may have others: :func:`may_differ`.
            distro: ROS 2 distribution whose name mapping applies.
        """
        slots: dict[Slot, None] = {}
        ros: set[int] = set()
        patterns: dict[Glob, None] = {}
        own = may_differ(kind, arguments)
        for _, rule_kind, permissions, expressions, partitions, _ in kind:
            if partitions or distro == ARDENT:
                return None
            for (topic, tail), each in product(needed_topics(rule_kind, permissions), expressions):
                if isinstance(each, int) and each >= 0:
                    slots[topic.prefix, each, tail + topic.suffix] = None
                    if topic.prefix:
                        ros.add(each)
                elif not own:
                    text = each if isinstance(each, str) else arguments[~each]
                    patterns.update((pattern, None) for pattern, _ in dds_patterns(distro, parse(text), topic, tail))
        wildcards = _with_intersections([*patterns])
        if wildcards is None:
            return None
        match = re.compile("|".join(f"(?:{regex(each)})" for each in wildcards) or "(?!)", re.DOTALL)
        return cls(tuple(slots), frozenset(ros), _own_slots(kind) if own else (), wildcards, match)

    def fit(self, arguments: Arguments) -> tuple[list[str], Signature] | None:
        """Return the DDS names of a subject, and what subjects with alike documents have in common.

        None if a name may be read in several ways, or is no ROS name. Expressions that may differ follow the names.
        """
        for number, argument in enumerate(arguments):
            is_read = is_fully_qualified(argument) if number in self.ros else PLAIN_TEXT.fullmatch(argument)
            if not is_read and "*" not in argument:
                return None
        names = [head + arguments[number] + tail for head, number, tail in self.slots]
        ends = _ends(self.own, arguments)
        related, short, expressions = _relations(ends)
        names += short
        first: dict[str, int] = {}
        equal = tuple(range(len(names)))
        if len({*names}) < len(names):
            equal = tuple(first.setdefault(name, index) for index, name in enumerate(names))
        if not self.own:
            match, found = self._any.fullmatch, tuple[int, ...]()
            if self.wildcards:
                found = tuple(self._matches(name) if match(name) else 0 for name in names)
            return names, (equal, found, b"")
        matches = (
            sum(1 << bit for bit, name in enumerate(names) if name.startswith(head) and name.endswith(tail, len(head)))
            for head, tail in ends
        )
        return [*names, *expressions], (equal, tuple(matches), related)

    def _matches(self, name: str) -> int:
        return sum(1 << bit for bit, pattern in enumerate(self.wildcards) if matcher(pattern)(name))


def may_differ(kind: Kind, arguments: Arguments) -> bool:
    """Tell whether a subject with other wildcards may have a document alike: each is a single ``*`` in plain text."""
    slots = _own_slots(kind) if "*" in "".join(arguments) else ()
    for prefix, number, _ in slots:
        text = arguments[number].replace("*", "x")
        if len(text) > MOST_LETTERS or not (is_fully_qualified(text) if prefix else PLAIN_TEXT.fullmatch(text)):
            return False
    ends = _ends(slots, arguments)
    return 0 < len(ends) <= MOST_WILDCARDS and len(_relations(ends)[1]) <= MOST_SHORT


@lru_cache(maxsize=1 << 10)
def _own_slots(kind: Kind) -> tuple[Slot, ...]:
    """Return the expressions with a ``*`` of a kind; none if it has other wildcards, too."""
    slots: dict[Slot, None] = {}
    for _, rule_kind, permissions, expressions, _, _ in kind:
        for each in expressions:
            if isinstance(each, str):
                return ()
            with suppress(KeyError):  # the engine reports an unknown permission
                for topic, tail in needed_topics(rule_kind, permissions) if each < 0 else ():
                    slots[topic.prefix, ~each, tail + topic.suffix] = None
    return tuple(slots)


def _ends(slots: Iterable[Slot], arguments: Arguments) -> Ends:
    texts = ((prefix, arguments[number].partition("*"), suffix) for prefix, number, suffix in slots)
    return tuple((prefix + head, tail + suffix) for prefix, (head, _, tail), suffix in texts)


@lru_cache(maxsize=1 << 8)
def _relations(ends: Ends) -> tuple[bytes, list[str], list[str]]:
    """Return how texts before and after a ``*`` are related, short names, and the expressions with all intersections.

    Short names begin and end as expressions do, with a part of the text before a ``*`` also after it.
    """
    related = bytes(head.startswith(begin) + 2 * tail.endswith(end) for head, tail in ends for begin, end in ends)
    heads, tails = dict.fromkeys(head for head, _ in ends), dict.fromkeys(tail for _, tail in ends)
    short = [
        [head + tail[size:] for size in range(1, len(tail) + 1) if head.endswith(tail[:size])]
        for head, tail in product(heads, tails)
    ]
    expressions = [f"{head}*{tail}" for head, tail in ends]
    for pair in combinations(ends, 2):
        (begin, head), (end, tail) = (sorted(texts, key=len) for texts in zip(*pair, strict=True))
        if head.startswith(begin) and tail.endswith(end):
            expressions.append(f"{head}*{tail}")
    return related + bytes(map(len, short)), [*chain.from_iterable(short)], expressions


def _with_intersections(patterns: Sequence[Glob]) -> tuple[Glob, ...] | None:
    """Return patterns and the intersections of any two; None if one is a name, has a set, or these are too many.

    The compiler writes intersections where one direction denies what the other allows. A name among them, or among
    the alternatives for a set, is the same text in the documents of all subjects.
    """
    found = dict.fromkeys(patterns)
    try:
        with step_limit(STEPS):
            for pair in combinations(patterns, 2) if len(patterns) <= MOST_WILDCARDS else ():
                found.update(dict.fromkeys(intersection(*pair)))
    except (TooComplexError, StepLimitError):
        return None
    sets = any(isinstance(token, Charset) and token != ANY for pattern in found for token in pattern)
    names = any(literal(pattern) is not None for pattern in found)
    return None if sets or names or len(found) > MOST_WILDCARDS else tuple(found)


MOST = 1_000
"""Kinds that are remembered."""
MOST_EXEMPLARS = 100
"""Members of a kind that are remembered."""
FEW_STEPS = 5_000
"""Steps of the engine for a member that is renamed: a tenth of any limit, so that none decides about a document."""

Domains = tuple[DomainRange, ...]

_SEMANTICS = tuple(variation.semantics for variation in VARIATIONS.values())


class _Made(Data):
    """What the engine made for a member.

    Attributes:
        arguments: the names in its rules.
        rules: the rules in its document.
        plain: these in plain form.
        sizes: bytes of its document, and of that in plain form.
        claims: what is proven about its document, and about every renamed one.
        notes: there are notes on its document.
        alike: what all that is renamed from it has in common.
    """

    arguments: Arguments
    rules: tuple[GrantRule[str], ...]
    plain: tuple[GrantRule[str], ...]
    sizes: tuple[int, int]
    claims: tuple[Claim, ...]
    notes: bool
    alike: object = field(default_factory=object, init=False, compare=False)

    def more_often_plain(self, texts: Iterable[str]) -> Mapping[str, int]:
        """Return how much more often the plain form has each of some topics, without those that it has as often."""
        times = Counter(topic for rule in self.plain for topic in rule.every_topic())
        times.subtract(topic for rule in self.rules for topic in rule.every_topic())
        return {text: times[text] for text in dict.fromkeys(texts) if times[text]}


class _Members(Data, frozen=False):
    """The members of a kind.

    Attributes:
        kind: the kind, which is known by its identity.
        first: the first member; None once it is among the exemplars.
        structure: None if no member can be renamed.
        exemplars: a member for each signature, with its DDS names and expressions, and how much more often the plain
            form has some of them.
    """

    kind: Kind
    first: _Made | None
    structure: Structure | None = None
    exemplars: dict[Signature, tuple[_Made, list[str], Mapping[str, int]]] = field(default_factory=dict)

    def keep(self, made: _Made) -> None:
        """Keep a member that the engine did as an exemplar, unless its document cannot be a template.

        Its topics must be sorted, as they are again for every other member. Those that are the same for all members
        must have wildcards; there are none if wildcards may differ.
        """
        fit = None if self.structure is None else self.structure.fit(made.arguments)
        if fit is None or len(self.exemplars) >= MOST_EXEMPLARS:
            return
        texts, signature = fit
        shared = {text for rule in (*made.rules, *made.plain) for text in rule.every_topic()}.difference(texts)
        odd = shared if signature[2] else [*filter(is_name, shared)]
        if with_renamed_topics(made.rules, {}) == made.rules and not odd:
            self.exemplars[signature] = made, texts, made.more_often_plain(texts)


_known: dict[tuple[int, str, Domains, tuple[str, ...]], _Members] = {}
"""Members by identity of the kind, distribution, domains, and the expressions with a ``*`` that all must have."""


def emit_by_kind(package: Package, options: BuildOptions) -> Emitted:
    """Return the permissions document of a package, equal in every byte to that of the engine.

    Raises:
        KeymintError: see :func:`keymint_ros2_dds.emit.emission.emit`.
    """
    if options != BuildOptions():
        return emit(package, options)
    kind, arguments = package.grant.rules.kind
    domains = package.grant.domains
    same = () if may_differ(kind, arguments) else tuple([text for text in arguments if "*" in text])
    key = id(kind), package.distro, domains, same  # to hash a kind takes long, and equal ones are one object
    members = _known.get(key)
    if members is not None:
        if members.first is not None:  # its structure is made for the second member, since many kinds have one only
            first, members.first = members.first, None
            members.structure = Structure.of(kind, arguments, package.distro)
            members.keep(first)
        emitted = _by_renaming(package, arguments, members)
        if emitted is not None:
            return emitted
    with step_limit(None) as counter:
        emitted = emit(package, options)
    compiled = emitted.compiled
    # Only a minimal document that is not gathered, and usual, is a template.
    minimal = compiled is not None and compiled.portable and (emitted.rules,) == compiled.forms
    if compiled is not None and minimal and counter.spent <= FEW_STEPS and emitted.is_usual(package.grant):
        sizes = len(emitted.document), emitted.plain_size
        made = _Made(arguments, emitted.rules, compiled.plain, sizes, emitted.claims, bool(emitted.diagnostics))
        if members is not None:
            members.keep(made)
        else:
            if len(_known) >= MOST:
                _known.pop(next(iter(_known)))
            _known[key] = _Members(kind, made)
    return emitted


def with_renamed_topics(rules: Sequence[GrantRule[str]], names: Mapping[str, str]) -> tuple[GrantRule[str], ...]:
    """Return rules with other names of topics, each list sorted as the compiler does."""
    get, renamed = names.get, list[GrantRule[str]]()
    for rule in rules:
        own = {action: tuple(sorted(map(get, texts, texts))) for action, texts in rule.topics.items()}
        renamed.append(GrantRule(rule.effect, rule.partitions, own))
    return tuple(renamed)


def _by_renaming(package: Package, arguments: Arguments, members: _Members) -> Emitted | None:
    """Return the document of a package by renaming; None if a condition of the lemma does not hold."""
    grant = package.grant
    fit = None if members.structure is None else members.structure.fit(arguments)
    found = members.exemplars.get(fit[1]) if fit else None
    if fit is None or found is None or not _is_plain(grant):
        return None
    (own, signature), (made, others, more_often) = fit, found
    names = dict(zip(others, own, strict=True))
    rules = with_renamed_topics(made.rules, names)
    if gathered_rules(rules) != rules:
        return None
    document = permissions_document.render(grant, rules)
    if signed_size(document) > TIGHT:
        return None
    dds_xml.know_valid(document, PERMISSIONS)
    claims.remember(comparison(package, document), made.claims)
    notes = tuple(vendor_notes(rules, grant)) if made.notes or signature[2] else ()
    size, plain_size = made.sizes
    plain_size += len(document) - size
    plain_size += sum(times * (len(names[text]) - len(text)) for text, times in more_often.items())
    # Some are perhaps not indented; a third of the limit all are, as no line grows to three times its length by that.
    if max(len(document), plain_size, *made.sizes) > dds_xml.INDENTED // 3:
        plain_size = len(permissions_document.render(grant, with_renamed_topics(made.plain, names)))
    return Emitted(document, rules, plain_size, None, made.claims, notes, made.alike)


def _is_plain(grant: Grant) -> bool:
    """Tell whether every model reads the head of a document as it is meant: the grant's name, subject and validity."""
    if not (PLAIN_TEXT.fullmatch(grant.name) and _is_ever_in_force(validity_of(grant))):
        return False
    if is_usual(grant.subject_name):
        return True
    try:
        text = subject_name_of(grant)
    except KeymintError:
        return False  # the engine says what is wrong first
    selected = all(semantics.selects(semantics.reads_text(text), text) for semantics in _SEMANTICS)
    return selected and PLAIN_TEXT.fullmatch(text) is not None


@lru_cache(maxsize=1 << 10)
def _is_ever_in_force(validity: Validity) -> bool:
    dates = dds_xml.date(validity.not_before), dds_xml.date(validity.not_after)
    grant = DocumentGrant("", *dates, rules=(), allows=False, line=0)
    return all(semantics.period(grant) is not None for semantics in _SEMANTICS)
