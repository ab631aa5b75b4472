# SPDX-License-Identifier: Apache-2.0
r"""Parse and expand attachments: expressions with ``{name}``, ``{namespace}`` and ``@{TUNABLE}``.

Loading splits an attachment into pieces. The text of a piece is a complete ``fnmatch`` expression in canonical
notation, so that concatenated pieces do not change each other's meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum
from itertools import product
from math import prod

from comarmor.errors import ComArmorError
from comarmor.patterns.expression import canonical, escape
from comarmor.patterns.tokens import COMARMOR, Bracket, next_token
from comarmor.regex import lazy_regex
from comarmor.text import did_you_mean, quoted
from comarmor.values import dataclass


class Placeholder(StrEnum):
    """A placeholder for a part of the subject's name."""

    NAME = "{name}"
    NAMESPACE = "{namespace}"


@dataclass(frozen=True, slots=True)
class TunableReference:
    """``@{NAME}``: a reference to a tunable; the attachment expands to each of its values."""

    name: str


Piece = str | Placeholder
Value = tuple[Piece, ...]

MOST_VALUES = 10_000
"""The most expressions that an attachment may expand to."""

MOST_CHARACTERS = 4096
"""The most characters of an expression."""

_NAME, _NAMESPACE = Placeholder.NAME, Placeholder.NAMESPACE
_PLAIN = lazy_regex(r"[^*?\[\\{}@\s]+")
_REFERENCE = lazy_regex(r"@\{([^{}]*)\}")
_BRACES = lazy_regex(r"\{[^{}]*\}?|\}")
_BARE_BRACE = lazy_regex(r"(?<!\\)(?:\\\\)*[{}]")
_BLANKS = " \t\r\n"


def strip(text: str) -> str:
    r"""Strip white space, but keep an escaped blank (``\ ``) at the end."""
    bare = text.strip(_BLANKS)
    if not bare.endswith("\\"):
        return bare
    backslashes = len(bare) - len(bare.rstrip("\\"))
    tail = text.lstrip(_BLANKS)[len(bare) : len(bare) + 1]
    return bare + tail if backslashes % 2 else bare


def parse(text: str) -> tuple[Piece | TunableReference, ...]:
    """Split an attachment into its pieces.

    Raises:
        ComArmorError: the notation is wrong; the caller adds the place.
    """
    if len(text) > MOST_CHARACTERS:
        raise ComArmorError(f"the expression is longer than {MOST_CHARACTERS:,} characters", code="expression")
    pieces: list[Piece | TunableReference] = []
    at = 0
    while at < len(text):
        if plain := _PLAIN.match(text, at):
            _add(pieces, plain[0])
            at = plain.end()
        elif reference := _REFERENCE.match(text, at):
            pieces.append(TunableReference(reference[1]))
            at = reference.end()
        elif text[at] in "{}":
            braces = _BRACES.match(text, at)
            placeholder = braces[0] if braces else text[at]
            if placeholder not in tuple(Placeholder):
                raise ComArmorError(
                    f"{quoted(placeholder)} is unknown, expected {{name}}, {{namespace}} or @{{TUNABLE}}",
                    help=did_you_mean(placeholder, Placeholder, "for the character itself write \\{ or \\}"),
                    code="brace",
                )
            pieces.append(Placeholder(placeholder))
            at += len(placeholder)
        else:
            token, end = next_token(text, at, COMARMOR)
            if isinstance(token, Bracket) and _BARE_BRACE.search(text, at, end):
                raise ComArmorError(
                    f"a brace inside the bracket expression {quoted(text[at:end])}",
                    help="write \\{ or \\} for a brace, or \\[ for a literal '['",
                    code="brace",
                )
            _add(pieces, canonical((token,)))
            at = end
    return tuple(pieces)


def _add(pieces: list[Piece | TunableReference], text: str) -> None:
    """Append text to pieces; adjacent texts are merged."""
    if pieces and type(pieces[-1]) is str:
        pieces[-1] += text
    else:
        pieces.append(text)


def expand(pieces: Sequence[Piece | TunableReference], values: Callable[[str], Sequence[Value]]) -> Iterator[Value]:
    """Expand the tunables of an attachment: yield every combination of their values, as AppArmor does.

    Args:
        pieces: the attachment, as :func:`parse` returns it.
        values: returns the expanded values of a tunable, or raises.

    Raises:
        ComArmorError: there are too many combinations, or one is too long.
    """
    written = tuple(piece for piece in pieces if not isinstance(piece, TunableReference))
    if len(written) == len(pieces):
        yield _bounded(written)
        return
    choices = [
        [(value, True) for value in values(piece.name)] if isinstance(piece, TunableReference) else [((piece,), False)]
        for piece in pieces
    ]
    number = prod(len(choice) for choice in choices)
    if number > MOST_VALUES:
        raise ComArmorError(
            f"the tunables have {number:,} combinations, more than the {MOST_VALUES:,} allowed", code="tunable"
        )
    for combination in product(*choices):
        yield _bounded(_join(_flat(combination)))


def _bounded(value: Value) -> Value:
    if sum(map(len, value)) > MOST_CHARACTERS:
        raise ComArmorError(f"the expression is longer than {MOST_CHARACTERS:,} characters", code="expression")
    return value


def _flat(combination: Iterable[tuple[Value, bool]]) -> Iterator[tuple[Piece, bool]]:
    """Yield the pieces of a combination (an empty value as ``""``), and whether each comes from an expansion."""
    for value, expanded in combination:
        yield from ((piece, expanded) for piece in value or ("",))


def parts(subject: str) -> tuple[str, str]:
    """Return the values of ``{namespace}`` and ``{name}`` for a subject, escaped.

    For ``/foo/bar/talker`` they are ``/foo/bar/`` and ``talker``.
    """
    head, slash, name = subject.rpartition("/")
    return escape(head + slash), escape(name)


def for_parts(value: Value, namespace: str, name: str) -> str:
    """Return the expression of an attachment for expressions of the namespace and of the name.

    Args:
        value: the attachment.
        namespace: expression that begins and ends with ``/``.
        name: expression of the last segment.
    """
    texts = [name if p is _NAME else namespace if p is _NAMESPACE else p for p in value]
    plain = "".join(texts)
    if "//" not in plain:
        return plain
    (joined,) = _join((text, isinstance(p, Placeholder)) for text, p in zip(texts, value, strict=True)) or ("",)
    return joined


def _join(pieces: Iterable[tuple[Piece, bool]]) -> Value:
    """Concatenate pieces. A ``//`` that an expansion creates becomes ``/``; one that was written stays.

    Args:
        pieces: pieces, and whether each comes from an expansion.
    """
    joined: list[Piece] = []
    meets_expansion = False
    for piece, expanded in pieces:
        if isinstance(piece, Placeholder):
            joined.append(piece)
            meets_expansion = False
            continue
        meets_expansion = meets_expansion or expanded
        if not piece:
            continue
        if joined and not isinstance(joined[-1], Placeholder):
            before = joined.pop()
            doubled = meets_expansion and before.endswith("/") and piece.startswith("/")
            joined.append(before + (piece[1:] if doubled else piece))
        else:
            joined.append(piece)
        meets_expansion = expanded
    return tuple(joined)
