# SPDX-License-Identifier: Apache-2.0
"""Parse XML elements into a policy: both dialects of attachments, tunables and includes."""

from __future__ import annotations

from collections.abc import Iterator

from lxml import etree

from comarmor.errors import ComArmorError, Diagnostic, Origin, require_none
from comarmor.language.attachments import (
    MOST_EXPANDED_CHARACTERS,
    ExpansionBudget,
    TunableScope,
    parse as parse_attachment,
    strip,
)
from comarmor.language.policy import Policy
from comarmor.language.policy_files import PolicyFile, PolicyFiles
from comarmor.language.source import INCLUDE
from comarmor.language.syntax import Attachment, Inclusion, Profile, ProfileRule, expected_of_subject, unique
from comarmor.patterns.expression import literal
from comarmor.rules import PERMISSIONS, Effect
from comarmor.text import quote
from comarmor.values import Data, field, replace
from comarmor.xml import schema

_DEEPEST = 64
_MOST_DIAGNOSTICS = 100


class _PlacedElement(Data):
    """An element with its file, and the chain of includes that led to the file."""

    element: etree._Element
    document: PolicyFile
    chain: tuple[Origin, ...]

    @property
    def where(self) -> Origin:
        return self.document.place(self.element, self.chain)

    @property
    def inner_chain(self) -> tuple[Origin, ...]:
        """The chain of the elements that this one includes."""
        return (self.document.place(self.element), *self.chain)


_Fragment = tuple[tuple[ProfileRule, ...], int]
"""The rules of a file that are the same wherever it is included, and the characters of its expressions."""


class _PolicyParser(Data, frozen=False):
    """Parses the documents of a policy in order, and collects every defect.

    Attributes:
        budget: tunables, and characters of expressions.
        diagnostics: the defects.
        fragments: by document and whether it is included into a watched profile; None for a document that must be
            parsed at each inclusion.
    """

    budget: ExpansionBudget = field(default_factory=ExpansionBudget)
    diagnostics: list[Diagnostic] = field(default_factory=list)
    fragments: dict[tuple[PolicyFile, bool], _Fragment | None] = field(default_factory=dict)

    def collect(self, error: ComArmorError, where: Origin) -> None:
        """Collect the defects of an error; those without a place get the given one."""
        for item in error.diagnostics:
            placed = item if item.where else replace(item, where=where)
            if placed not in self.diagnostics:
                self.diagnostics.append(placed)
        if len(self.diagnostics) >= _MOST_DIAGNOSTICS:
            raise ComArmorError.of(self.diagnostics)

    def refuse(self, message: str, where: Origin, code: str, help_: str = "") -> None:
        """Collect a defect."""
        self.collect(ComArmorError(message, where=where, help=help_, code=code), where)

    def root(self, document: PolicyFile) -> tuple[Profile, ...]:
        """Return the profiles of a root file."""
        scope = TunableScope(self.budget)
        item = _PlacedElement(document.root, document, ())
        if document.root.tag == "profiles":
            profiles = self.profiles(item, scope)
            if not document.short.copies:
                return profiles
            from comarmor.language.alike_profiles import with_copies  # noqa: PLC0415 - small policies do without

            return with_copies(document, profiles, self.budget)
        if document.root.tag == "profile":
            return tuple(self.profile(item, scope, audit=False, depth=1))
        self.refuse(
            f"<{document.root.tag}> is not expected as the root of a policy, expected <profiles> or <profile>",
            item.where,
            "rule-outside",
            "move a file that is only included into a sub-folder of the policy's folder",
        )
        return ()

    def children(self, item: _PlacedElement, *, audit: bool | None = None) -> Iterator[_PlacedElement]:
        """Yield the child elements of an element, with includes replaced by the included elements.

        Args:
            item: the element.
            audit: whether it is a watched profile; if given, an include with a :meth:`fragment` is not replaced.
        """
        for element in item.element:
            child = _PlacedElement(element, item.document, item.chain)
            if element.tag != INCLUDE or (audit is not None and self.fragment(child, audit=audit)):
                yield child
                continue
            included = item.document.includes[element]
            if audit is None and included.package:
                self.refuse(
                    f"a file of the package {quote(included.package)} is included outside of a profile",
                    child.where,
                    "package-outside",  # it could attach to any subject
                    "move the xi:include into a <profile>, "
                    "whose <attachment> limits the subjects that the file is about",
                )
                continue
            inner = _PlacedElement(included.root, included, child.inner_chain)
            if included.root.tag == "profiles":
                yield from self.children(inner, audit=audit)
            else:
                yield inner

    def fragment(self, include: _PlacedElement, *, audit: bool) -> _Fragment | None:
        """Return the rules that an include adds to a profile; None if they must be parsed at each inclusion."""
        key = include.document.includes[include.element], audit
        if key not in self.fragments:
            self.fragments[key] = _PolicyParser(fragments=self.fragments).alone(*key)
        fragment = self.fragments[key]
        return fragment if fragment and self.budget.used + fragment[1] <= MOST_EXPANDED_CHARACTERS else None

    def alone(self, document: PolicyFile, audit: bool) -> _Fragment | None:
        """Return the rules of a file; None if it has other elements, needs tunables, or has defects."""
        root = _PlacedElement(document.root, document, ())
        rules: list[ProfileRule] = []
        for child in self.children(root, audit=audit) if document.root.tag == "profiles" else (root,):
            if child.element.tag == INCLUDE:
                rules += self.inclusion(child, audit=audit).placed()
            elif child.element.tag in PERMISSIONS:
                rules.append(self.rule(child, TunableScope(self.budget), audit=audit))
            else:
                return None
        return None if self.diagnostics else (tuple(rules), self.budget.used)

    def inclusion(self, include: _PlacedElement, *, audit: bool) -> Inclusion:
        """Return the rules of an include that has a :meth:`fragment`."""
        rules, characters = self.fragments[include.document.includes[include.element], audit] or ((), 0)
        self.budget.used += characters
        return Inclusion(rules, include.inner_chain)

    def profiles(self, item: _PlacedElement, scope: TunableScope) -> tuple[Profile, ...]:
        """Return the profiles in a ``<profiles>`` element."""
        nested: list[Profile] = []
        for child in self.children(item):
            if child.element.tag == "tunable":
                self.tunable(child, scope)
            elif child.element.tag == "profile":
                nested += self.profile(child, scope, audit=False, depth=1)
            else:
                self.refuse(
                    f"<{child.element.tag}> is included outside of a profile, where rules are not allowed",
                    child.where,
                    "rule-outside",
                    "move the xi:include into a <profile>",
                )
        return tuple(nested)

    def profile(self, item: _PlacedElement, around: TunableScope, *, audit: bool, depth: int) -> Iterator[Profile]:
        """Yield the profile of a ``<profile>`` element, unless it is nested too deeply."""
        if depth > _DEEPEST:
            self.refuse(f"profiles are nested more than {_DEEPEST} deep", item.where, "xml-limit")
            return
        scope = TunableScope(self.budget, around)
        audit = audit or item.element.get("modifier") == "AUDIT"
        attachments: list[Attachment] = []
        inner: list[Profile] = []
        parts: list[ProfileRule | Inclusion] = []
        for child in self.children(item, audit=audit):
            tag = child.element.tag
            if tag == "tunable" and child.document.package and not item.document.package:
                self.refuse(
                    "a file that a package ships declares a tunable in the profile that includes it",
                    child.where,
                    "package-tunable",
                    "declare it inside a <profile> of that file, or in the policy that includes it",
                )
            elif tag == "tunable":
                self.tunable(child, scope)
            elif tag in ("attachment", "attachments"):
                attachments += self.subjects(child, scope)
            elif tag == "profile":
                inner += self.profile(child, scope, audit=audit, depth=depth + 1)
            elif tag == INCLUDE:
                parts.append(self.inclusion(child, audit=audit))
            else:
                parts.append(self.rule(child, scope, audit=audit))
        name = item.element.get("name", "")
        yield Profile(name, audit, unique(attachments), tuple(inner), tuple(parts), item.where)

    def tunable(self, item: _PlacedElement, scope: TunableScope) -> None:
        """Declare a tunable."""
        values = [strip(value.text or "") for value in item.element]
        try:
            scope.declare(item.element.get("name", ""), values, item.where)
        except ComArmorError as error:
            self.collect(error, item.where)

    def subjects(self, item: _PlacedElement, scope: TunableScope) -> Iterator[Attachment]:
        """Yield the attachments of a profile."""
        for expression in self.attachments(item.element, item, scope):
            if expression.value:
                self.refuse(
                    "{name} and {namespace} are only allowed in the attachments of rules",
                    expression.where,
                    "brace",
                    "use a tunable @{…}, or a wildcard",
                )
                continue
            if expected := expected_of_subject(expression.text):
                name = quote(literal(expression.text) or "")
                self.refuse(f"{name} is not a legal name of a subject", expression.where, "subject-name", expected)
            yield expression

    def attachments(self, own: etree._Element, item: _PlacedElement, scope: TunableScope) -> Iterator[Attachment]:
        """Yield the expressions of an ``<attachment>`` or ``<attachments>`` element of a profile or rule."""
        for element in own if own.tag == "attachments" else (own,):
            where = item.document.place(element, item.chain)
            try:
                values = scope.expand(element.text or "", where)
            except ComArmorError as error:
                self.collect(error, where)
                continue
            for value in values:
                if any(value):
                    yield Attachment.of(value, where)
                else:
                    self.refuse("the attachment is empty", where, "expression", "for any name write *")

    def rule(self, item: _PlacedElement, scope: TunableScope, *, audit: bool) -> ProfileRule:
        """Return the rule of an element."""
        attachments: list[Attachment] = []
        granted: set[str] = set()
        partitions: tuple[str, ...] = ()
        for child in item.element:
            if child.tag == "permissions":
                granted = {str(permission.tag) for permission in child}
            elif child.tag == "partitions":
                partitions = self.partitions(child, item)
            else:
                attachments += self.attachments(child, item, scope)
        kind, effect = str(item.element.tag), Effect(item.element.get("qualifier", ""))
        permissions = tuple(permission for permission in PERMISSIONS[kind] if permission in granted)
        audit = audit or item.element.get("modifier") == "AUDIT"
        return ProfileRule(effect, kind, permissions, unique(attachments), partitions, audit, item.where)

    def partitions(self, element: etree._Element, item: _PlacedElement) -> tuple[str, ...]:
        """Return the expressions of a ``<partitions>`` element; tunables and placeholders are not allowed."""
        expressions: dict[str, None] = {}
        for child in element:
            where = item.document.place(child, item.chain)
            try:
                pieces = parse_attachment(strip(child.text or ""))
            except ComArmorError as error:
                self.collect(error, where)
                continue
            if any(type(piece) is not str for piece in pieces):
                self.refuse(
                    "a partition cannot contain a tunable, {name} or {namespace}",
                    where,
                    "brace",
                    "for the character itself write \\{ or \\}",
                )
            expressions["".join(str(piece) for piece in pieces)] = None
        return tuple(expressions)


def parse(sources: PolicyFiles) -> Policy:
    """Return the policy of documents.

    Args:
        sources: the documents.

    Raises:
        ComArmorError: with every defect, each with ``file:line`` and its chain of includes.
    """
    parser = _PolicyParser()
    for document, chain in sources.documents():
        try:
            schema.validate(document.root, "comarmor", "comarmor", document.name, chain)
        except ComArmorError as error:
            parser.collect(error, Origin(document.name))
    require_none(parser.diagnostics)
    profiles = tuple(profile for document in sources.roots for profile in parser.root(document))
    require_none(parser.diagnostics)
    budget = parser.budget
    unused = tuple(each for key, each in budget.tunables.items() if key not in budget.used_tunables)
    return Policy(profiles, sources.seen, unused, sources.shipped)
