# SPDX-License-Identifier: Apache-2.0
"""Policies that are written: those of rules, and the smallest that allows a graph.

Policies are XML in the canonical form of :func:`comarmor.render`, with includes added. They are made from the needs of
subjects (permissions on objects in partitions) and the rules that grant them.

:func:`learn` works as aa-genprof generates AppArmor profiles. With the learned policy, a subject may do exactly what
its edges require. An edge on an action or parameter requires all its parts, and an endpoint in several partitions
requires each of them. Rules that several subjects share move into included files, where that makes the policy shorter.
An existing policy is compared with the graph: edges that it denies, and permissions that no edge uses, are reported.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from keymint_comarmor.loaded import ComArmorPolicy
from lxml import etree

import comarmor
from comarmor.language import formatting
from comarmor.language.attachments import MOST_CHARACTERS, parts as subject_parts
from comarmor.language.parse import parse
from comarmor.language.source import INCLUDE, read_document
from comarmor.language.syntax import Attachment, Profile, ProfileRule
from comarmor.patterns.expression import escape, matches
from comarmor.rules import PERMISSIONS, Effect, Rule, parts
from comarmor.text import quote
from comarmor.values import Data, field
from comarmor.xml.reader import XINCLUDE
from keymint.api import LearnedPolicy, LoadedPolicy
from keymint.api.graph import Edge, Graph, general_expression, is_generated
from keymint.errors import Diagnostic, KeymintError, Origin, Spot, require_none
from keymint.ir import SubjectRules
from keymint.names import name_of

Need = tuple[str, str, str, tuple[str, ...]]
"""Kind, attachment or name, permission, and partitions; no partitions means the default one."""

NOWHERE = Origin("learned")
"""The origin of learned rules, which are not in a file yet."""
_KINDS = tuple(PERMISSIONS)


class CommonPart(Data):
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
    profile = _profile(name, "*", rules)
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
    require_none(too_long)
    document = profiles({each.subject: _folded(each.rules) for each in subjects}, note.replace("--", "- -"))
    policy = parse(read_document(document, name, Path("/")))  # it includes nothing, so it may be read from anywhere
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


def share(needs: Mapping[str, set[Need]]) -> tuple[CommonPart, ...]:
    """Return the common parts that make the policy shorter, in bytes of all its files.

    The needs that a group of subjects shares are one candidate. Larger groups are tried first.
    """
    remaining = {subject: set(own_needs) for subject, own_needs in needs.items()}
    parts: list[CommonPart] = []
    for _, shared in sorted(_candidates(remaining).items(), key=lambda item: (-len(item[0]), item[0])):
        covered = {subject: frozenset(by_template.values()) for subject, by_template in shared.items()}
        common = frozenset(next(iter(shared.values())))
        saved_bytes = -len(fragment(common))
        for subject, own_needs in covered.items():
            before, after = (
                len(profiles({"p": fold(map(literal, needs))}))
                for needs in (remaining[subject], remaining[subject] - own_needs)
            )
            saved_bytes += before - after - INCLUDE_SIZE
        if saved_bytes > 0:
            for subject, own_needs in covered.items():
                remaining[subject] -= own_needs
            parts.append(CommonPart(f"common_{len(parts) + 1}.xml", common, covered))
    return tuple(parts)


def _candidates(needs: Mapping[str, set[Need]]) -> dict[tuple[str, ...], dict[str, dict[Need, Need]]]:
    """Return the candidates by group of subjects: for each subject its needs by their common template."""
    holders: dict[Need, set[str]] = {}
    for subject, own_needs in needs.items():
        for need in own_needs:
            for template in templates(need, subject):
                holders.setdefault(template, set()).add(subject)
    groups: dict[tuple[str, ...], dict[str, dict[Need, Need]]] = {}
    for subject, own_needs in needs.items():
        for need in own_needs:
            best = max(templates(need, subject), key=lambda template: len(holders[template]))
            if len(holders[best]) > 1:
                groups.setdefault(tuple(sorted(holders[best])), {}).setdefault(subject, {})[best] = need
    shared: dict[tuple[str, ...], dict[str, dict[Need, Need]]] = {}
    for subjects, group in groups.items():
        common = frozenset.intersection(*map(frozenset, group.values()))
        if common and len(group) == len(subjects):  # otherwise some share theirs better in another group
            own = {subject: {each: by_template[each] for each in common} for subject, by_template in group.items()}
            shared[subjects] = own
    return shared


_Request = tuple[str, str, str, tuple[str, ...]]
"""Kind, permission, name and partitions of an elementary request."""
_Unit = tuple[Spot, str]
"""Place of an attachment, and a permission. The place, because the expanded text depends on the subject."""


def unused_rule_notes(policy: comarmor.Policy, graph: Graph) -> Iterator[Diagnostic]:
    """Yield notes on rules that no edge of a graph uses, and on subjects of the policy that the graph does not have."""
    units: dict[Spot, dict[_Unit, bool]] = {}
    needs: dict[str, set[_Request]] = {}
    for edge in graph.edges:
        needs.setdefault(edge.subject, set()).update(
            (kind, permission, edge.object.name + suffix, edge.object.partitions or ("",))
            for kind, permission, suffix in parts(edge.object.kind, edge.permission)
        )
    for subject in graph.subjects:
        for rule in (rule for profile in policy.applicable(subject) for rule in profile.rules):
            if rule.effect is comarmor.Effect.ALLOW:
                usage = units.setdefault(rule.where.spot, {})
                for unit, used in _used(rule, subject, needs.get(subject, ())):
                    usage[unit] = usage.get(unit, False) or used
    for place, usage in sorted(units.items()):
        yield from _unused_units(place, usage)
    for subject in policy.subjects():
        if subject not in graph.subjects:
            message = f"the policy names {subject}, which the graph does not have"
            yield Diagnostic.note("learn-unused-subject", message, subject=subject)


def _used(rule: comarmor.ProfileRule, subject: str, needs: Iterable[_Request]) -> Iterator[tuple[_Unit, bool]]:
    """Yield each attachment and permission of a rule, and whether the subject needs it."""
    for permission in rule.permissions:
        candidates = [
            (name.removesuffix(suffix), partitions)
            for kind, needed, name, partitions in needs
            for part_kind, part_permission, suffix in parts(rule.kind, permission)
            if (part_kind, part_permission) == (kind, needed) and name.endswith(suffix)
        ]
        for attachment in rule.attachments:
            expression = attachment.for_parts(*subject_parts(subject))
            used = any(
                matches(expression, name) and any(_in_partition(rule, partition) for partition in partitions)
                for name, partitions in candidates
            )
            yield (attachment.where.spot, permission), used


def _in_partition(rule: comarmor.ProfileRule, partition: str) -> bool:
    if rule.partitions:
        return any(matches(expression, partition) for expression in rule.partitions)
    return partition == ""


def _unused_units(place: Spot, usage: dict[_Unit, bool]) -> Iterator[Diagnostic]:
    """Yield notes on one rule that is not used, or on attachments and permissions of it that are not used."""
    if not any(usage.values()):
        permissions = ", ".join(dict.fromkeys(permission for _, permission in usage))
        yield _note("learn-unused-rule", place, f"no subject in the graph uses this rule ({permissions})")
        return
    for attachment in dict.fromkeys(unit[0] for unit in usage):
        if not any(used for unit, used in usage.items() if unit[0] == attachment):
            yield _note("learn-unused-attachment", attachment, "no subject in the graph uses this attachment")
    for permission in dict.fromkeys(unit[1] for unit in usage):
        if not any(used for unit, used in usage.items() if unit[1] == permission):
            yield _note("learn-unused-permission", place, f"no subject in the graph uses {permission} of this rule")


def _note(code: str, place: Spot, message: str) -> Diagnostic:
    file, line, column = place
    where = Origin(file, line, (), column)
    return Diagnostic.note(code, message, where, "remove it unless it is for a rare case")


def learn(graph: Graph, existing: LoadedPolicy | None, fragments: str) -> LearnedPolicy:
    """Return the rules that a graph needs in addition to an existing policy; see :class:`keymint.api.PolicyType`.

    Raises:
        KeymintError: the existing policy is not of this type.
    """
    if existing is not None and not isinstance(existing, ComArmorPolicy):
        raise KeymintError("the existing policy is not a ComArmor policy", code="policy-type")
    policy = existing.policy if existing else None
    missing: list[Edge] = []
    conflicts = []
    for edge in graph.edges:
        if policy is None:
            missing.append(edge)
            continue
        requested = edge.object
        decision = policy.decide(edge.subject, requested.kind, edge.permission, requested.name, requested.partitions)
        if decision.allowed:
            continue
        # Only a DENY rule is a conflict; without one an ALLOW rule is missing.
        denied = next((part for part in decision.parts or (decision,) if not part.allowed and part.rule), None)
        if denied is None or denied.where is None:
            missing.append(edge)
            continue
        message = f"this rule denies {edge.subject} the {edge.permission} on {quote(requested.name)} that the graph has"
        help_ = "narrow the rule, or leave it: a DENY wins over every ALLOW"
        conflicts.append(Diagnostic.warning("learn-denied", message, denied.where.alone(), help_, edge.subject))
    subjects = [each for each in graph.subjects if policy is None or not policy.applicable(each)]
    granted = needs_of(missing)
    needs = {subject: granted.get(subject, set()) for subject in sorted({*subjects, *granted})}
    parts = share(needs) if fragments else ()
    domains = sorted({edge.domain for edge in graph.edges})
    shown = ", ".join(map(str, domains))
    # A policy cannot express DDS domains; nothing is said about the default one.
    note = f"Learned in DDS domain {shown}; this document holds no domain: its workspace does." if any(domains) else ""
    return LearnedPolicy(
        document=document(needs, parts, fragments, note) if needs else b"",
        fragments={part.name: fragment(part.needs, part.name.removesuffix(".xml")) for part in parts},
        missing=tuple(missing),
        conflicts=tuple(dict.fromkeys(conflicts)),
        unused=tuple(unused_rule_notes(policy, graph)) if policy else (),
        notes=tuple(_generated(missing, needs)),
    )


def _generated(edges: Iterable[Edge], subjects: Iterable[str]) -> Iterator[Diagnostic]:
    """Yield a note for each expression that matches more than its name, and for each subject with a generated name."""
    told: set[str] = set()
    for edge in edges:
        expression, what = general_expression(edge.object.name, edge.object.kind)
        if what and expression not in told:
            told.add(expression)
            message = f"{expression} stands for {edge.object.name}: {what} changes with each start"
            yield Diagnostic.note("learn-generated", message, subject=edge.subject)
    for subject in filter(is_generated, subjects):
        message = f"the name of {subject} changes with each start, so its profile is about no enclave"
        help_ = "record it with its enclave, or name it: keymint discover --subject ID=NAME"
        yield Diagnostic.note("learn-generated", message, None, help_, subject)
