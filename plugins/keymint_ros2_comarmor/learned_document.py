# SPDX-License-Identifier: Apache-2.0
"""Write learned rules as XML, in the canonical form of :func:`comarmor.render` with includes added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lxml import etree

from comarmor.language import render
from comarmor.language.source import INCLUDE
from comarmor.language.syntax import Attachment, Profile, ProfileRule
from comarmor.patterns.expression import escape
from comarmor.xml.reader import XINCLUDE
from keymint.names import name_of
from keymint_ros2_comarmor.learned_rules import NOWHERE, CommonPart, Need, fold, literal

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
    root = etree.Element("profiles", nsmap={"xi": XINCLUDE} if parts else None)
    for subject, own_needs in needs.items():
        covered = {need for part in parts for need in part.covered.get(subject, ())}
        rules = fold(map(literal, own_needs - covered))
        profile = _profile(name_of(subject), escape(subject), rules)
        root.append(profile)
        for part in reversed(parts):
            if subject in part.subjects:
                profile.insert(1, etree.Element(INCLUDE, href=f"{folder}/{part.name}", parse="xml"))
    return _noted(root, note)


def fragment(part: CommonPart) -> bytes:
    """Return the file of a common part: a rule, or for several rules a profile that applies to any subject."""
    return _fragment(fold(part.needs), part.name.removesuffix(".xml"))


def _fragment(rules: tuple[ProfileRule, ...], name: str) -> bytes:
    profile = _profile(name, _ANY_SUBJECT, rules)
    return render.document(profile if len(rules) > 1 else profile[1]).encode()


def fragment_size(rules: tuple[ProfileRule, ...]) -> int:
    """Return the size in bytes of an included file with these rules."""
    return len(_fragment(rules, "common_1"))


def profile_size(rules: tuple[ProfileRule, ...]) -> int:
    """Return the size in bytes of a policy with one profile of these rules."""
    return len(profiles({"p": rules}))


def profiles(subjects: Mapping[str, tuple[ProfileRule, ...]], note: str = "") -> bytes:
    """Return a policy document with one profile of rules for each subject.

    Args:
        subjects: the rules of each subject.
        note: a comment to insert before the root element; empty for none.
    """
    root = etree.Element("profiles")
    for subject, rules in subjects.items():
        root.append(_profile(name_of(subject), escape(subject), rules))
    return _noted(root, note)


def _noted(root: etree._Element, note: str) -> bytes:
    policy = render.document(root).encode()
    return policy.replace(b"<profiles", f"<!-- {note} -->\n<profiles".encode(), 1) if note else policy


def _profile(name: str, attachment: str, rules: tuple[ProfileRule, ...]) -> etree._Element:
    """Return the element of a profile with one attachment."""
    attachments = (Attachment(attachment, NOWHERE),)
    return render.profile(Profile(name, audit=False, attachments=attachments, profiles=(), parts=rules, where=NOWHERE))
