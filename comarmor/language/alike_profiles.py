# SPDX-License-Identifier: Apache-2.0
"""Profiles that are written like one above them but for names, as in a policy of a fleet: one of a form is parsed.

The others are taken out of the document before it is parsed, and made of the profile of that one and of their own
names. A profile is taken out only if nothing but white space is between it and the end of the profile above it; that
this one is a profile, and no part of a comment, shows when the shorter document is parsed. Where anything is not as
expected, an error makes the caller read the document as a whole, which also finds all defects.
"""

from __future__ import annotations

from itertools import accumulate, chain

from comarmor.errors import ComArmorError, Origin
from comarmor.language.attachments import MOST_EXPANDED_CHARACTERS, ExpansionBudget
from comarmor.language.policy_files import PolicyFile, ProfileCopy, ShortDocument
from comarmor.language.syntax import Attachment, Inclusion, Profile, ProfileRule, expected_of_subject, unique
from comarmor.text import lazy_regex
from comarmor.xml.reader import LIMITS

_BEGIN, _END = b'<profile name="', b"</profile>"
_NAME = lazy_regex(rb"[\w/*. -]{1,4096}")
_TEXTS = lazy_regex(rb"<attachment>([\w/*.-]{1,4096})</attachment>")
"""Attachments whose text is the expression in canonical notation."""
_ENDS_LINE = lazy_regex(rb"[^\n<]*(?:</[^\n<]*)*\n")
_ODD = lazy_regex(rb"<(?:profile|tunable|!|\?)")


def short_form(content: bytes) -> ShortDocument:
    """Return a document without profiles that are written like others above them."""
    forms: dict[tuple[bytes, ...], tuple[int, tuple[int, ...]]] = {}
    left: list[bytes] = []
    copies: list[ProfileCopy] = []
    kept: set[tuple[int, int]] = set()
    line, follows, above = 1, False, (0, 0)
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
            kept |= {above, (first, len(indent) + 1)}
            left += gap, b"\n" * body.count(b"\n"), b" " * len(body.rpartition(b"\n")[2] + _END)
        else:
            left += segment, _END
            above = line, len(indent) + 1
            # What is after a comment may be in it, and would make all copies of it doubtful.
            if is_plain and gap.isspace() and all(map(_ENDS_LINE.match, (*pieces[:-1:2], pieces[-1] + b"\n"))):
                lines = tuple(accumulate((piece.count(b"\n") for piece in pieces[:-1:2]), initial=line))[1:]
                forms.setdefault(form, (line, lines))
        follows = is_plain
        line += body.count(b"\n")
    return ShortDocument(b"".join((*left, rest)), tuple(copies), frozenset(kept))


def with_copies(file: PolicyFile, profiles: tuple[Profile, ...], budget: ExpansionBudget) -> tuple[Profile, ...]:
    """Return the outermost profiles of a file as a whole.

    Args:
        file: the file.
        profiles: those of its document without copies, with those that it includes.
        budget: counts the characters of expressions.

    Raises:
        ComArmorError: the document must be read as a whole.
    """
    own = {profile.where.line: profile for profile in profiles if not profile.where.chain}
    copies, kept = file.short.copies, file.short.kept
    is_expected = not file.inclusions and kept <= {
        (profile.where.line, profile.where.column) for profile in own.values()
    }
    first = {copy.first: copy for copy in copies} if is_expected else {}
    characters: dict[int, int] = {}
    for line, copy in first.items():
        attachments = [*own[line].attachments, *chain.from_iterable(rule.attachments for rule in own[line].rules)]
        characters[line] = sum(len(each.text) for each in attachments)
        # One that is twice in a rule of the first profile is once in what was parsed.
        places = {each.where.line for each in attachments if not each.where.chain}
        is_expected = is_expected and places.issuperset(copy.texts)
    budget.used += sum(characters.get(copy.first, 0) + sum(map(len, copy.texts.values())) for copy in copies)
    is_expected = is_expected and budget.used <= MOST_EXPANDED_CHARACTERS
    made = [_copied(own[copy.first], copy) for copy in copies if is_expected]
    if not is_expected or any(expected_of_subject(each.text) for profile in made for each in profile.attachments):
        raise ComArmorError("a profile, an attachment or a name of a subject is not what it seems to be")
    return tuple(sorted((*profiles, *made), key=lambda profile: (profile.where.chain or (profile.where,))[-1].line))


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
