# SPDX-License-Identifier: Apache-2.0
"""Translate an SROS2 policy to ComArmor: load it, so that every verb that reads a policy can read it, or write it anew.

An enclave is a profile; one that is written has the comments of the policy, and the names of its nodes as comments. To
compare both, what SROS2 writes from the policy is given too.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

from keymint_comarmor.loaded import ComArmorPolicy
from lxml import etree

import comarmor
from comarmor.language import formatting
from comarmor.language.formatting import canonical_form
from comarmor.language.loading import load_included
from comarmor.language.parse import parse as parse_comarmor
from comarmor.language.policy import Policy
from comarmor.language.source import read_document
from comarmor.language.syntax import Attachment, Profile, ProfileRule
from comarmor.patterns.expression import escape
from comarmor.rules import PERMISSIONS, Effect, Rule
from comarmor.values import replace
from comarmor.xml.reader import XINCLUDE
from keymint.api import ImportedPolicy, ImportedSubject, ImportRequest, PolicySource
from keymint.errors import Diagnostic, KeymintError, Severity, require_none
from keymint.ir import SubjectRules
from keymint.names import name_of
from keymint_ros2_sros2 import syntax
from keymint_ros2_sros2.deviations import ACCEPTABLE, deviations, permissions_document, subject_name
from keymint_ros2_sros2.parse import parse
from keymint_ros2_sros2.syntax import expression


def load(sources: Sequence[PolicySource], *_of_includes: object) -> ComArmorPolicy:
    """Load policies as one; see :meth:`keymint.api.PolicyType.load`. Includes are in the policy's own folder.

    Raises:
        KeymintError: a policy is not valid, or SROS2 enforces something else than it reads; with ``file:line``.
    """
    seen: dict[Path, bytes] = {}
    profiles: dict[str, Profile] = {}
    findings: list[Diagnostic] = []
    for source in sources:
        policy = parse(source.path)
        require_none(deviations(policy))
        seen |= policy.seen
        findings += (each for each in _notes(policy) if each.severity is Severity.WARNING)
        for enclave in policy.enclaves:
            if enclave.path in profiles:
                message = f"the enclave {enclave.path} is also at {profiles[enclave.path].where}"
                raise KeymintError(message, where=enclave.where, help="write one <enclave>", code="sros2-path-twice")
            rules = (
                ProfileRule(
                    rule.effect, rule.kind, rule.permissions,
                    tuple(Attachment(expression, rule.origin) for expression in rule.expressions),
                    rule.partitions, rule.audit, rule.origin,
                )
                for rule in syntax.rules_of([enclave], graph=policy.has_graph)
            )  # fmt: skip
            name = Attachment(enclave.path, enclave.where)
            profiles[enclave.path] = Profile(enclave.path, False, (name,), (), tuple(rules), enclave.where)
    return ComArmorPolicy(comarmor.Policy(tuple(profiles.values()), seen=MappingProxyType(seen)), findings)


Atom = tuple[Effect, str, str, str]
"""Effect, kind, permission and expression of a part of a rule."""
_FOLDER = "common"


def atoms(rules: Collection[Rule]) -> frozenset[Atom]:
    """Return the parts of rules: one for each effect, kind, permission and expression."""
    return frozenset(
        (rule.effect, rule.kind, permission, expression)
        for rule in rules
        for permission in rule.permissions
        for expression in rule.expressions
    )


def common_files(library: Path, subject: str, wanted: Collection[Atom]) -> dict[str, frozenset[Atom]]:
    """Return files of the library that a profile of a subject may include in place of rules, with what they grant.

    Args:
        library: folder of the library.
        subject: the subject.
        wanted: what the subject is granted; nothing beyond it is granted by the files.
    """
    left = set(wanted)
    found: dict[str, frozenset[Atom]] = {}
    candidates = [(name, atoms(policy.rules(subject))) for name, policy in _policies(library)]
    for name, granted in sorted(candidates, key=lambda each: (-len(each[1]), each[0])):
        if granted and granted <= left:
            found[name] = granted
            left -= granted
    return found


@lru_cache(maxsize=4)
def _policies(library: Path) -> tuple[tuple[str, Policy], ...]:
    """Return the files of the library, each in a profile for all subjects; without those that need a tunable."""
    found: list[tuple[str, Policy]] = []
    for path in sorted((library / _FOLDER).rglob("*.xml")):
        name = path.relative_to(library).as_posix()
        try:
            found.append((name, load_included(name, name, library)))
        except KeymintError as error:
            if any(each.code != "tunable" for each in error.diagnostics):
                raise
    return tuple(found)


_INCLUDE = f"{{{XINCLUDE}}}include"
_GRAPH: frozenset[Atom] = frozenset(
    (Effect.ALLOW, "topic", each, syntax.GRAPH_TOPIC) for each in ("publish", "subscribe")
)
"""What SROS2 allows by itself."""


def comarmor_document(
    enclaves: Iterable[Sequence[syntax.Sros2Enclave]], closing: Iterable[str], library: Path, *, graph: bool
) -> bytes:
    """Return a policy as a ComArmor document.

    Args:
        enclaves: its enclaves; those with the same path become one profile.
        closing: the comments at its end.
        library: folder of the policy library.
        graph: with what SROS2 allows by itself.
    """
    root = etree.Element("profiles", nsmap={"xi": XINCLUDE})
    for group in enclaves:
        root.append(_profile(group, library, graph=graph))
    _comment(root, closing)
    text = formatting.document(root)
    # A prefix that nothing uses would only puzzle.
    content = (text if "<xi:include" in text else text.replace(f' xmlns:xi="{XINCLUDE}"', "", 1)).encode()
    return canonical_form(content, "the new policy") or content  # comments have the indentation of the old policy


def _profile(enclaves: Sequence[syntax.Sros2Enclave], library: Path, *, graph: bool) -> etree._Element:
    path = enclaves[0].path
    profile = etree.Element("profile", name=name_of(path))
    etree.SubElement(profile, "attachment").text = escape(path)
    own = atoms([rule for rule in syntax.rules_of(enclaves, graph=False) if rule.origin.chain])
    shared = common_files(library, path, own | _GRAPH if graph else own)
    for name in shared:
        etree.SubElement(profile, _INCLUDE, href=name, parse="xml")
    written = {atom for granted in shared.values() for atom in granted}
    for enclave in enclaves:
        _comment(profile, enclave.comments)
        for group in enclave.groups:
            _comment(profile, group.comments)
            for node in group.nodes:
                _node(profile, node, written)
            _comment(profile, group.closing)
        _comment(profile, enclave.closing)
    if graph and not written >= _GRAPH:
        _comment(profile, [" SROS2 allows this to every enclave "])
        profile.append(_rule(Effect.ALLOW, "topic", ("publish", "subscribe"), [(syntax.GRAPH_TOPIC, ())]))
    return profile


def _node(profile: etree._Element, node: syntax.RosNode, written: set[Atom]) -> None:
    """Add the rules of a node; what the profile has of included files is not written twice."""
    _comment(profile, [*node.comments, f" the node {node.name} in the namespace {node.ns or '/'} "])
    for rules in node.lists:
        made = list(_rules(node, rules, written))
        _comment(profile, rules.introduction)
        if made or not rules.included:
            _comment(profile, rules.comments)
            profile.extend(made)
            _comment(profile, rules.closing)
    _comment(profile, node.closing)


def _rules(node: syntax.RosNode, rules: syntax.RuleList, written: set[Atom]) -> Iterator[etree._Element]:
    """Yield the rules of a list: one for each effect, and for each set of permissions that names still need."""
    kind = syntax.KINDS[rules.tag]
    names = [(expression(syntax.as_read(node, entry.text), entry), entry.comments) for entry in rules.entries]
    for effect in Effect:
        given = [permission for permission, each in rules.effects.items() if each is effect]
        needs: dict[tuple[str, ...], list[tuple[str, tuple[str, ...]]]] = {}
        for name, comments in names:
            missing = tuple(each for each in given if (effect, kind, each, name) not in written or not rules.included)
            if missing:
                needs.setdefault(missing, []).append((name, comments))
            if rules.included:
                written |= {(effect, kind, each, name) for each in missing}
        for permissions, listed in needs.items():
            yield _rule(effect, kind, permissions, listed)


def _rule(
    effect: Effect, kind: str, permissions: Sequence[str], names: Sequence[tuple[str, Sequence[str]]]
) -> etree._Element:
    element = etree.Element(kind, qualifier=effect.value)
    holder = etree.SubElement(element, "attachments") if len(names) > 1 else element
    for name, comments in names:
        _comment(holder, comments)
        etree.SubElement(holder, "attachment").text = name
    granted = etree.SubElement(element, "permissions")
    for permission in PERMISSIONS[kind]:
        if permission in permissions:
            etree.SubElement(granted, permission)
    return element


def _comment(parent: etree._Element, texts: Iterable[str]) -> None:
    for text in texts:
        plain = re.sub("-(?=-)", "- ", text)
        parent.append(etree.Comment(f"{plain} " if plain.endswith("-") else plain))


def translate_policy(request: ImportRequest) -> ImportedPolicy:
    """Translate a policy; see :meth:`keymint.api.PolicyType.translated`.

    Raises:
        KeymintError: the policy is not valid, cannot be expressed, or SROS2 enforces something else than it reads and
            that is not accepted; every defect with its ``file:line``.
    """
    policy = parse(request.path)
    found = deviations(policy)
    require_none(each for each in found if not (request.accept and each.code in ACCEPTABLE))
    graph = request.implicit and policy.has_graph
    enclaves: dict[str, list[syntax.Sros2Enclave]] = {}
    for enclave in policy.enclaves:
        enclaves.setdefault(enclave.path, []).append(enclave)
    document = comarmor_document(enclaves.values(), policy.closing, request.library, graph=graph)
    loaded = parse_comarmor(read_document(document, request.name, request.library, request.library_shown))
    deviating = {each.subject for each in found}
    subjects = tuple(
        ImportedSubject(
            SubjectRules(path, loaded.rules(path)),
            # Of an enclave that stands twice, generate_artifacts uses the last.
            permissions_document(group[-1], graph=graph),
            subject_name(group[-1]),
            path in deviating,
        )
        for path, group in enclaves.items()
    )
    help_ = "the new policy has it as it reads (--as-written)"
    accepted = (replace(each, severity=Severity.WARNING, help=help_) for each in found)
    return ImportedPolicy(document, subjects, (*accepted, *_notes(policy)))


def _notes(policy: syntax.SourcePolicy) -> Iterator[Diagnostic]:
    """Yield a note for what is lost, for lists without meaning, and for logs that stay in a namespace."""
    yield from policy.lost
    for enclave in policy.enclaves:
        for node in enclave.nodes():
            for rules in node.lists:
                if not rules.effects:
                    message = f"<{rules.tag}> has no qualifier, so that it allows and denies nothing"
                    help_ = " or ".join(f'{each}="ALLOW"' for each in syntax.PERMISSIONS[rules.tag])
                    yield Diagnostic.warning("sros2-no-qualifier", message, rules.where, f"add {help_}", enclave.path)
                for entry in rules.entries:
                    name = syntax.as_read(node, entry.text)
                    if rules.tag == "topics" and entry.text.strip() == "rosout" and name != "/rosout":
                        message = f"'rosout' is {name} here, but nodes publish their log to /rosout"
                        help_ = "allow /rosout as well"
                        yield Diagnostic.warning("sros2-rosout", message, entry.where, help_, enclave.path)
