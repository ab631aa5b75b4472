"""Learned rules as XML, in the canonical form of :func:`comarmor.render`, with the includes that it has no word for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from lxml import etree

import comarmor
from comarmor.language.syntax import Attachment, Profile, ProfileRule
from comarmor.patterns.printing import escape
from keymint_ros2_comarmor.learned_rules import NOWHERE, Needs, fold, literal, literal_needs

if TYPE_CHECKING:
    from keymint_ros2_comarmor.common_parts import CommonPart

XI = "http://www.w3.org/2001/XInclude"
_ANY_SUBJECT = "*"
_TYPICAL_INCLUDE = '    <xi:include href="policy.d/common_1.xml" parse="xml"/>\n'


def document(needs: Mapping[str, Needs], parts: Sequence[CommonPart], folder: str, note: str = "") -> bytes:
    """Return the policy: one profile for each subject.

    Args:
        needs: what each subject needs.
        parts: what is stated in files of their own.
        folder: their folder, relative to the policy.
        note: a comment to put in front of the policy; none if empty.
    """
    profiles = []
    for subject, found in literal_needs(needs).items():
        elsewhere = {need for part in parts for need in part.covered.get(subject, ())}
        rules = fold(map(literal, found - elsewhere))
        profiles.append(_profile(subject.removeprefix("/"), escape(subject), rules))
    text = comarmor.render(comarmor.Policy(tuple(profiles)))
    if not parts:
        return _noted(text.encode(), note)
    root = etree.fromstring(text.encode(), etree.XMLParser(remove_blank_text=True))
    included = etree.Element("profiles", nsmap={"xi": XI})
    for subject, element in zip(needs, list(root), strict=True):
        included.append(element)
        for part in reversed(parts):
            if subject in part.subjects:
                element.insert(1, etree.Element(f"{{{XI}}}include", href=f"{folder}/{part.name}", parse="xml"))
    return _noted(_written(included), note)


def _noted(policy: bytes, note: str) -> bytes:
    """Put a comment in front of the root element."""
    return policy.replace(b"<profiles", f"<!-- {note} -->\n<profiles".encode(), 1) if note else policy


def fragment(part: CommonPart) -> bytes:
    """Return the file of a common part: one rule, or a profile for any subject that includes it."""
    return _fragment(fold(part.needs), part.name.removesuffix(".xml"))


def _fragment(rules: tuple[ProfileRule, ...], name: str) -> bytes:
    text = comarmor.render(comarmor.Policy((_profile(name, _ANY_SUBJECT, rules),)))
    root = etree.fromstring(text.encode(), etree.XMLParser(remove_blank_text=True))
    return _written(root[0] if len(rules) > 1 else root[0][1])


def fragment_size(rules: tuple[ProfileRule, ...]) -> int:
    """Return the bytes of the file that these rules make."""
    return len(_fragment(rules, "common_1"))


def include_size() -> int:
    """Return the bytes that one include takes, about."""
    return len(_TYPICAL_INCLUDE)


def rules_size(rules: tuple[ProfileRule, ...]) -> int:
    """Return the bytes that rules take in a profile."""
    empty = comarmor.render(comarmor.Policy((_profile("p", "p", ()),)))
    return len(comarmor.render(comarmor.Policy((_profile("p", "p", rules),))).encode()) - len(empty)


def _profile(name: str, attachment: str, rules: tuple[ProfileRule, ...]) -> Profile:
    return Profile(
        name, audit=False, attachments=(Attachment(attachment, NOWHERE),), profiles=(), rules=rules, where=NOWHERE
    )


def _written(root: etree._Element) -> bytes:
    etree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{etree.tostring(root, encoding="unicode")}\n'.encode()
