# SPDX-License-Identifier: Apache-2.0
"""The needs of subjects (permissions on objects in partitions), the rules that grant them, and the policies of rules.

Policies are XML in the canonical form of :func:`comarmor.render`, with includes added.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from pathlib import Path

from lxml import etree

from comarmor.errors import ComArmorError, Diagnostic, Origin
from comarmor.language import formatting
from comarmor.language.attachments import MOST_CHARACTERS
from comarmor.language.parse import parse
from comarmor.language.source import INCLUDE, read_document
from comarmor.language.syntax import Attachment, Profile, ProfileRule
from comarmor.patterns.expression import escape
from comarmor.rules import PERMISSIONS, Effect, Rule
from comarmor.values import dataclass
from comarmor.xml.reader import XINCLUDE
from keymint.api.graph import Edge, general_expression
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint.names import name_of

Need = tuple[str, str, str, tuple[str, ...]]
"""Kind, attachment or name, permission, and partitions; no partitions means the default one."""

NOWHERE = Origin("learned")
"""The origin of learned rules, which are not in a file yet."""
_KINDS = tuple(PERMISSIONS)


@dataclass(frozen=True, slots=True)
class CommonPart:
    """An included file with the needs that several subjects share.

    Attributes:
        name: file name.
        needs: the shared needs, as attachments that may contain ``{namespace}`` and ``{name}``.
        covered: for each subject that includes it, its own needs (with names) that the file covers.
    """

    name: str
    needs: frozenset[Need]
    covered: Mapping[str, frozenset[Need]] = field(repr=False)


def needs_of(edges: Iterable[Edge]) -> dict[str, set[Need]]:
    """Return the needs of each subject, with names; the partitions of one permission on one object are merged."""
    partitions: dict[str, dict[tuple[str, str, str], set[str]]] = {}
    for edge in edges:
        key = edge.object.kind, edge.object.name, edge.permission
        partitions.setdefault(edge.subject, {}).setdefault(key, set()).update(edge.object.partitions or ("",))
    return {
        subject: {(*key, () if names == {""} else tuple(sorted(names))) for key, names in by_key.items()}
        for subject, by_key in partitions.items()
    }


def fold(needs: Iterable[Need], effect: Effect = Effect.ALLOW) -> tuple[ProfileRule, ...]:
    """Return the fewest rules that grant needs, sorted; each object occurs once for each list of partitions.

    Args:
        needs: needs with attachments and expressions of partitions, not names.
        effect: whether the rules allow them, or deny them.
    """
    permissions: dict[tuple[str, str, tuple[str, ...]], set[str]] = {}
    for kind, attachment, permission, partitions in needs:
        permissions.setdefault((kind, attachment, partitions), set()).add(permission)
    attachments: dict[tuple[str, tuple[str, ...], tuple[str, ...]], set[str]] = {}
    for (kind, attachment, partitions), granted in permissions.items():
        ordered = tuple(permission for permission in PERMISSIONS[kind] if permission in granted)
        attachments.setdefault((kind, ordered, partitions), set()).add(attachment)
    return tuple(
        ProfileRule(
            effect=effect,
            kind=kind,
            permissions=granted_in_order,
            attachments=tuple(Attachment(text, NOWHERE) for text in sorted(texts)),
            partitions=partitions,
            audit=False,
            where=NOWHERE,
        )
        for (kind, granted_in_order, partitions), texts in sorted(attachments.items(), key=_order)
    )


def _order(item: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], set[str]]) -> tuple[object, ...]:
    (kind, permissions, partitions), attachments = item
    known = PERMISSIONS[kind]
    return _KINDS.index(kind), partitions, [known.index(permission) for permission in permissions], sorted(attachments)


def literal(need: Need) -> Need:
    """Return a need with the attachment of its name, see :func:`expression`, and expressions of its partitions."""
    kind, name, permission, partitions = need
    return kind, expression(name, kind), permission, tuple(map(escape, partitions))


def expression(name: str, kind: str) -> str:
    """Return an attachment that matches a name, or its end from a ``/`` on, whatever is made at run time in it."""
    return general_expression(escape(name), kind)[0]


def templates(need: Need, subject: str) -> tuple[Need, ...]:
    """Return the attachments of a need that subjects may share: literal, and relative to the subject's name."""
    kind, name, permission, partitions = need
    texts = [expression(name, kind)]
    namespace = subject[: subject.rindex("/") + 1]
    if kind != "topic":
        if name == subject or name.startswith(f"{subject}/"):
            texts.append("{namespace}{name}" + expression(name.removeprefix(subject), kind))
        elif name.startswith(namespace) and namespace != "/":
            texts.append("{namespace}" + expression(name.removeprefix(namespace), kind))
    return tuple((kind, text, permission, tuple(map(escape, partitions))) for text in texts)


_ANY_SUBJECT = "*"
INCLUDE_SIZE = len('    <xi:include href="policy.d/common_1.xml" parse="xml"/>\n')
"""Bytes of a typical include."""


def document(needs: Mapping[str, set[Need]], parts: Sequence[CommonPart], folder: str, note: str = "") -> bytes:
    """Return the policy document, with one profile for each subject.

    Args:
        needs: the needs of each subject.
        parts: the needs in included files.
        folder: folder of the included files, relative to the policy.
        note: a comment to insert before the root element; empty for none.
    """
    rules: dict[str, tuple[ProfileRule, ...]] = {}
    includes: dict[str, list[str]] = {}
    for subject, own_needs in needs.items():
        own_parts = [part for part in parts if subject in part.covered]
        rules[subject] = fold(map(literal, own_needs.difference(*(part.covered[subject] for part in own_parts))))
        includes[subject] = [f"{folder}/{part.name}" for part in own_parts]
    return profiles(rules, note, includes if parts else {})


def fragment(needs: Iterable[Need], name: str = "common_1") -> bytes:
    """Return an included file: a rule, or for several rules a profile that applies to any subject."""
    rules = fold(needs)
    profile = _profile(name, _ANY_SUBJECT, rules)
    return formatting.document(profile if len(rules) > 1 else profile[1]).encode()


def profiles(
    subjects: Mapping[str, tuple[ProfileRule, ...]], note: str = "", includes: Mapping[str, Sequence[str]] | None = None
) -> bytes:
    """Return a policy document with one profile of rules for each subject.

    Args:
        subjects: the rules of each subject.
        note: a comment to insert before the root element; empty for none.
        includes: the files that the profile of each subject includes, if there are any.
    """
    root = etree.Element("profiles", nsmap={"xi": XINCLUDE} if includes else None)
    for subject, rules in subjects.items():
        profile = _profile(name_of(subject), escape(subject), rules)
        root.append(profile)
        for href in reversed(includes[subject] if includes else ()):
            profile.insert(1, etree.Element(INCLUDE, href=href, parse="xml"))
    policy = formatting.document(root).encode()
    return policy.replace(b"<profiles", f"<!-- {note} -->\n<profiles".encode(), 1) if note else policy


def _profile(name: str, attachment: str, rules: tuple[ProfileRule, ...]) -> etree._Element:
    """Return the element of a profile with one attachment."""
    attachments = (Attachment(attachment, NOWHERE),)
    return formatting.profile(
        Profile(name, audit=False, attachments=attachments, profiles=(), parts=rules, where=NOWHERE)
    )


def policy_of(subjects: Sequence[SubjectRules], name: str, note: str = "") -> tuple[bytes, tuple[SubjectRules, ...]]:
    """Write a policy; see :meth:`keymint.api.PolicyType.policy_of`.

    Raises:
        KeymintError: an expression or the name of a subject cannot be written.
    """
    message = f"has a name of more than {MOST_CHARACTERS:,} characters, which no policy can hold"
    too_long = [
        Diagnostic.error("expression", message, rule.origin, "shorten it", each.subject)
        for each in subjects
        for rule in each.rules
        if max(map(len, (*rule.expressions, *rule.partitions))) > MOST_CHARACTERS
    ]
    if too_long:
        raise KeymintError.of(too_long)
    document = profiles({each.subject: _folded(each.rules) for each in subjects}, note.replace("--", "- -"))
    try:  # the document includes nothing, so that it may be read from anywhere
        policy = parse(read_document(document, name, Path("/")))
    except ComArmorError as error:
        raise KeymintError.of(error.diagnostics) from None
    return document, tuple(SubjectRules(each.subject, policy.rules(each.subject)) for each in subjects)


def _folded(rules: Iterable[Rule]) -> tuple[ProfileRule, ...]:
    found: tuple[ProfileRule, ...] = ()
    for effect in Effect:
        needs = (
            (rule.kind, expression, permission, rule.partitions)
            for rule in rules
            if rule.effect is effect
            for expression in rule.expressions
            for permission in rule.permissions
        )
        found += fold(needs, effect)
    return found
