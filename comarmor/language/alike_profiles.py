# SPDX-License-Identifier: Apache-2.0
"""Profiles that are written like one above them but for names, as in a policy of a fleet: one of a form is parsed.

The others are taken out of the document before it is parsed, and made of the profile of that one and of their own
names. A profile is taken out only if nothing but white space is between it and the end of the profile above it; that
this one is a profile, and no part of a comment, shows when the shorter document is parsed. Where anything is not as
expected, an error makes the caller read the document as a whole, which also finds all defects.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate, chain

from comarmor.errors import ComArmorError, Origin
from comarmor.language.attachments import ExpansionBudget
from comarmor.language.syntax import Attachment, Inclusion, Profile, ProfileRule, expected_of_subject, unique
from comarmor.regex import lazy_regex
from comarmor.values import dataclass
from comarmor.xml.reader import LIMITS

_BEGIN, _END = b'<profile name="', b"</profile>"
_NAME = lazy_regex(rb"[\w/*. -]{1,4096}")
_TEXTS = lazy_regex(rb"<attachment>([\w/*.-]{1,4096})</attachment>")
"""Attachments whose text is the expression in canonical notation."""
_ENDS_LINE = lazy_regex(rb"[^\n<]*(?:</[^\n<]*)*\n")
_ODD = lazy_regex(rb"<(?:profile|tunable|!|\?)")


@dataclass(frozen=True, slots=True)
class ProfileCopy:
    """A profile that is taken out.

    Attributes:
        first: the line where the first profile of its form begins.
        line: the line where it begins itself.
        name: its name.
        texts: what it has as texts of attachments, by their lines in the first profile.
    """

    first: int
    line: int
    name: str
    texts: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class ShortDocument:
    """A document without the profiles that are like others.

    Attributes:
        content: the rest, in the same lines and columns.
        copies: what was taken out, in order.
        kept: line and column where profiles must be that are left.
    """

    content: bytes
    copies: tuple[ProfileCopy, ...]
    kept: frozenset[tuple[int, int]]

    def completed(self, profiles: tuple[Profile, ...], budget: ExpansionBudget) -> tuple[Profile, ...]:
        """Return the outermost profiles of a document as a whole.

        Args:
            profiles: those of this document, with those that it includes.
            budget: counts the characters of their expressions.

        Raises:
            ComArmorError: the document must be read as a whole.
        """
        own = {profile.where.line: profile for profile in profiles if not profile.where.chain}
        is_expected = self.kept <= {(profile.where.line, profile.where.column) for profile in own.values()}
        first = {copy.first: copy for copy in self.copies} if is_expected else {}
        characters: dict[int, int] = {}
        for line, copy in first.items():
            attachments = [*own[line].attachments, *chain.from_iterable(rule.attachments for rule in own[line].rules)]
            characters[line] = sum(len(each.text) for each in attachments)
            # One that is twice in a rule of the first profile is once in what was parsed.
            places = {each.where.line for each in attachments if not each.where.chain}
            is_expected = is_expected and places.issuperset(copy.texts)
        budget.used += sum(characters.get(copy.first, 0) + sum(map(len, copy.texts.values())) for copy in self.copies)
        made = [_copied(own[copy.first], copy) for copy in self.copies if is_expected]
        if not is_expected or any(expected_of_subject(each.text) for profile in made for each in profile.attachments):
            raise ComArmorError("a profile, an attachment or a name of a subject is not what it seems to be")
        return tuple(sorted((*profiles, *made), key=lambda profile: (profile.where.chain or (profile.where,))[-1].line))


def short_form(content: bytes) -> ShortDocument | None:
    """Return a document without profiles that are written like others above them; None if there are none."""
    forms: dict[tuple[bytes, ...], tuple[int, tuple[int, ...]]] = {}
    left: list[bytes] = []
    copies: list[ProfileCopy] = []
    kept: set[tuple[int, int]] = set()
    line, follows = 1, False
    tags, most = content.count(b"<"), content.count(b">") + 2 * content.count(b"=")
    is_small = tags <= LIMITS.nodes and tags + most <= LIMITS.parts and len(content) <= LIMITS.file_bytes
    *segments, rest = content.split(_END) if is_small and b"\r" not in content else (content,)
    for segment in segments:
        gap, _, body = segment.partition(_BEGIN)
        _, newline, indent = gap.rpartition(b"\n")
        name, _, inside = body.partition(b'"')
        line += gap.count(b"\n")
        is_plain = bool(newline and _NAME.fullmatch(name)) and not _ODD.search(inside)
        pieces = _TEXTS.split(inside)
        form = indent, *pieces[::2]
        if is_plain and follows and form in forms and gap.isspace():
            first, lines = forms[form]
            texts = dict(zip(lines, b"\n".join(pieces[1::2]).decode().split("\n"), strict=False))
            copies.append(ProfileCopy(first, line, name.decode(), texts))
            left += gap, b"\n" * body.count(b"\n"), b" " * len(body.rpartition(b"\n")[2] + _END)
        else:
            left += segment, _END
            if is_plain:
                kept.add((line, len(indent) + 1))
            if is_plain and all(map(_ENDS_LINE.match, (*pieces[:-1:2], pieces[-1] + b"\n"))):
                lines = tuple(accumulate((piece.count(b"\n") for piece in pieces[:-1:2]), initial=line))[1:]
                forms.setdefault(form, (line, lines))
        follows = is_plain
        line += body.count(b"\n")
    return ShortDocument(b"".join((*left, rest)), tuple(copies), frozenset(kept)) if copies else None


def _copied(profile: Profile, copy: ProfileCopy) -> Profile:
    """Return the profile that is written like another one, which is the first of its form."""
    shift, texts = copy.line - copy.first, copy.texts

    def moved(where: Origin) -> Origin:
        return Origin(where.file, where.line + shift, where.chain, where.column)

    def filled(attachments: tuple[Attachment, ...]) -> tuple[Attachment, ...]:
        return unique([Attachment(texts.get(at.where.line, at.text), moved(at.where), at.value) for at in attachments])

    def of_part(part: ProfileRule | Inclusion) -> ProfileRule | Inclusion:
        if isinstance(part, Inclusion):
            return Inclusion(part.rules, (moved(part.chain[0]),))
        given, attachments, where = part.permissions, filled(part.attachments), moved(part.where)
        return ProfileRule(part.effect, part.kind, given, attachments, part.partitions, part.audit, where)

    parts = tuple([of_part(part) for part in profile.parts])
    return Profile(copy.name, profile.audit, filled(profile.attachments), (), parts, moved(profile.where))
