# SPDX-License-Identifier: Apache-2.0
"""Write enclaves as a ComArmor policy: a profile for each, with its comments and the names of its nodes as comments."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from lxml import etree

from comarmor.language import render
from comarmor.language.formatting import canonical_form
from comarmor.patterns.expression import escape
from comarmor.rules import PERMISSIONS, Effect
from comarmor.xml.reader import XINCLUDE
from keymint.names import name_of
from keymint_ros2_sros2.common_files import Atom, atoms, common_files
from keymint_ros2_sros2.names import as_read, expression
from keymint_ros2_sros2.rules import GRAPH_TOPIC, rules_of
from keymint_ros2_sros2.syntax import KINDS, RosNode, RuleList, Sros2Enclave

_INCLUDE = f"{{{XINCLUDE}}}include"
_GRAPH: frozenset[Atom] = frozenset((Effect.ALLOW, "topic", each, GRAPH_TOPIC) for each in ("publish", "subscribe"))
"""What SROS2 allows by itself."""


def document(
    enclaves: Iterable[Sequence[Sros2Enclave]], closing: Iterable[str], library: Path, *, graph: bool
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
    text = render.document(root)
    # A prefix that nothing uses would only puzzle.
    content = (text if "<xi:include" in text else text.replace(f' xmlns:xi="{XINCLUDE}"', "", 1)).encode()
    return canonical_form(content, "the new policy") or content  # comments have the indentation of the old policy


def _profile(enclaves: Sequence[Sros2Enclave], library: Path, *, graph: bool) -> etree._Element:
    path = enclaves[0].path
    profile = etree.Element("profile", name=name_of(path))
    etree.SubElement(profile, "attachment").text = escape(path)
    own = atoms([rule for rule in rules_of(enclaves, graph=False) if rule.origin.chain])
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
        profile.append(_rule(Effect.ALLOW, "topic", ("publish", "subscribe"), [(GRAPH_TOPIC, ())]))
    return profile


def _node(profile: etree._Element, node: RosNode, written: set[Atom]) -> None:
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


def _rules(node: RosNode, rules: RuleList, written: set[Atom]) -> Iterator[etree._Element]:
    """Yield the rules of a list: one for each effect, and for each set of permissions that names still need."""
    kind = KINDS[rules.tag]
    names = [(expression(as_read(node, entry.text), entry), entry.comments) for entry in rules.entries]
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
