"""Write learned rules as XML, in the canonical form of :func:`comarmor.render` with includes added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lxml import etree

import comarmor
from comarmor.language.syntax import Attachment, Profile, ProfileRule
from comarmor.patterns.printing import escape
from keymint_ros2_comarmor.learned_rules import NOWHERE, CommonPart, Needs, fold, literal, literal_needs

XI = "http://www.w3.org/2001/XInclude"
_ANY_SUBJECT = "*"
INCLUDE_SIZE = len('    <xi:include href="policy.d/common_1.xml" parse="xml"/>\n')
"""Bytes of a typical include."""


def document(needs: Mapping[str, Needs], parts: Sequence[CommonPart], folder: str, note: str = "") -> bytes:
    """Return the policy document, with one profile for each subject.

    Args:
        needs: the needs of each subject.
        parts: the needs in included files.
        folder: folder of the included files, relative to the policy.
        note: a comment to insert before the root element; empty for none.
    """
    profiles = []
    for subject, own_needs in literal_needs(needs).items():
        covered = {need for part in parts for need in part.covered.get(subject, ())}
        rules = fold(map(literal, own_needs - covered))
        profiles.append(_profile(subject.removeprefix("/"), escape(subject), rules))
    text = comarmor.render(comarmor.Policy(tuple(profiles)))
    if not parts:
        return _with_note(text.encode(), note)
    root = etree.fromstring(text.encode(), etree.XMLParser(remove_blank_text=True))
    included = etree.Element("profiles", nsmap={"xi": XI})
    for subject, element in zip(needs, list(root), strict=True):
        included.append(element)
        for part in reversed(parts):
            if subject in part.subjects:
                element.insert(1, etree.Element(f"{{{XI}}}include", href=f"{folder}/{part.name}", parse="xml"))
    return _with_note(_xml(included), note)


def _with_note(policy: bytes, note: str) -> bytes:
    """Insert a comment before the root element."""
    return policy.replace(b"<profiles", f"<!-- {note} -->\n<profiles".encode(), 1) if note else policy


def fragment(part: CommonPart) -> bytes:
    """Return the file of a common part: a rule, or for several rules a profile that applies to any subject."""
    return _fragment(fold(part.needs), part.name.removesuffix(".xml"))


def _fragment(rules: tuple[ProfileRule, ...], name: str) -> bytes:
    text = comarmor.render(comarmor.Policy((_profile(name, _ANY_SUBJECT, rules),)))
    root = etree.fromstring(text.encode(), etree.XMLParser(remove_blank_text=True))
    return _xml(root[0] if len(rules) > 1 else root[0][1])


def fragment_size(rules: tuple[ProfileRule, ...]) -> int:
    """Return the size in bytes of an included file with these rules."""
    return len(_fragment(rules, "common_1"))


def profile_size(rules: tuple[ProfileRule, ...]) -> int:
    """Return the size in bytes of a policy with one profile of these rules."""
    return len(comarmor.render(comarmor.Policy((_profile("p", "p", rules),))).encode())


def _profile(name: str, attachment: str, rules: tuple[ProfileRule, ...]) -> Profile:
    return Profile(
        name, audit=False, attachments=(Attachment(attachment, NOWHERE),), profiles=(), rules=rules, where=NOWHERE
    )


def _xml(root: etree._Element) -> bytes:
    etree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{etree.tostring(root, encoding="unicode")}\n'.encode()
