# SPDX-License-Identifier: Apache-2.0
r"""Attachments: expressions with ``{name}``, ``{namespace}`` and ``@{TUNABLE}``, and the tunables in lexical scopes.

Loading splits an attachment into pieces. The text of a piece is a complete ``fnmatch`` expression in canonical
notation, so that concatenated pieces do not change each other's meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import product
from math import prod

from comarmor.errors import ComArmorError, Origin, Spot
from comarmor.patterns.expression import canonical, escape
from comarmor.patterns.tokens import COMARMOR, Bracket, next_token
from comarmor.text import did_you_mean, lazy_regex, quote
from comarmor.values import Data, field


class Placeholder(str):
    """A placeholder for a part of the subject's name."""

    __slots__ = ()


NAME, NAMESPACE = PLACEHOLDERS = Placeholder("{name}"), Placeholder("{namespace}")


class TunableReference(Data):
    """``@{NAME}``: a reference to a tunable; the attachment expands to each of its values."""

    name: str


Piece = str | Placeholder
Value = tuple[Piece, ...]

MOST_VALUES = 10_000
"""The most expressions that an attachment may expand to."""

MOST_CHARACTERS = 4096
"""The most characters of an expression."""

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
        elif placeholder := next((each for each in PLACEHOLDERS if text.startswith(each, at)), None):
            pieces.append(placeholder)
            at += len(placeholder)
        elif braces := _BRACES.match(text, at):
            near = "{namespace}" if braces[0] == "{ns}" else braces[0]
            message = f"{quote(braces[0])} is unknown, expected {{name}}, {{namespace}} or @{{TUNABLE}}"
            help_ = did_you_mean(near, PLACEHOLDERS, "for the character itself write \\{ or \\}")
            raise ComArmorError(message, help=help_, code="brace")
        elif reference := _REFERENCE.match(text, at):
            pieces.append(TunableReference(reference[1]))
            at = reference.end()
        else:
            token, end = next_token(text, at, COMARMOR)
            if isinstance(token, Bracket) and _BARE_BRACE.search(text, at, end):
                message = f"a brace inside the bracket expression {quote(text[at:end])}"
                help_ = "write \\{ or \\} for a brace, or \\[ for a literal '['"
                raise ComArmorError(message, help=help_, code="brace")
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
        message = f"the tunables have {number:,} combinations, more than the {MOST_VALUES:,} allowed"
        raise ComArmorError(message, code="tunable")
    for combination in product(*choices):
        yield _bounded(_join(combination))


def _bounded(value: Value) -> Value:
    if sum(map(len, value)) > MOST_CHARACTERS:
        raise ComArmorError(f"the expression is longer than {MOST_CHARACTERS:,} characters", code="expression")
    return value


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
    texts = [p if type(p) is str else name if p == NAME else namespace for p in value]
    plain = "".join(texts)
    if "//" not in plain:
        return plain
    (joined,) = _join(((text,), isinstance(p, Placeholder)) for text, p in zip(texts, value, strict=True)) or ("",)
    return joined


def _join(values: Iterable[tuple[Value, bool]]) -> Value:
    """Concatenate values. A ``//`` that an expansion creates becomes ``/``; one that was written stays.

    Args:
        values: pieces, and whether they come from an expansion; without pieces it is an empty one.
    """
    joined: list[Piece] = []
    meets_expansion = False
    for piece, expanded in ((piece, expanded) for value, expanded in values for piece in value or ("",)):
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


MOST_EXPANDED_CHARACTERS = 32 * 2**20
"""The most characters of all expanded expressions of a policy."""


class Tunable(Data):
    """A variable: its name, its expanded values, and where it is declared."""

    name: str
    values: tuple[Value, ...]
    where: Origin

    @property
    def key(self) -> tuple[Spot, str]:
        """Its place and its name."""
        return self.where.spot, self.name


def _tunable_error(name: str, problem: str, where: Origin | None, help_: str = "") -> ComArmorError:
    return ComArmorError(f"the tunable @{{{name}}} {problem}", where=where, help=help_, code="tunable")


class ExpansionBudget(Data, frozen=False):
    """The characters that a policy's expanded expressions use, its tunables, and the keys of those that are used.

    A tunable of a file that is included several times is counted once.
    """

    used: int = 0
    tunables: dict[tuple[Spot, str], Tunable] = field(default_factory=dict)
    used_tunables: set[tuple[Spot, str]] = field(default_factory=set)


class TunableScope(Data, frozen=False):
    """The scope of a ``<profiles>`` or ``<profile>`` element.

    Attributes:
        budget: shared by the complete policy.
        outer: the enclosing scope.
        own: the tunables declared so far.
        passed: by name, a tunable of an enclosing scope that this scope had not declared, and the place of its first
            use.
    """

    budget: ExpansionBudget
    outer: TunableScope | None = None
    own: dict[str, Tunable] = field(default_factory=dict)
    passed: dict[str, tuple[Tunable, Origin]] = field(default_factory=dict)

    def declare(self, name: str, values: Sequence[str], where: Origin) -> None:
        """Declare a tunable in this scope; from here on it hides tunables of the same name in enclosing scopes.

        Raises:
            ComArmorError: this scope has declared the name, or used an outer tunable of that name, or a value refers to
                the tunable itself, or is wrong.
        """
        if name in self.own:
            first = f"the first declaration is at {self.own[name].where}"
            raise _tunable_error(name, "is declared twice in this scope", where, first)
        if name in self.passed:
            outer, use = self.passed[name]
            problem = f"is declared after its use at {use}, which refers to the one declared at {outer.where}"
            raise _tunable_error(name, problem, where, "declare it above its use, or give it another name")
        # Declared even if defective, so that its uses are not reported as well.
        self.own[name] = Tunable(name, (), where)
        expanded: dict[Value, None] = {}
        for value in values:
            pieces = parse(value)
            if TunableReference(name) in pieces:
                raise _tunable_error(name, "refers to itself", where)
            expanded.update(dict.fromkeys(expand(pieces, partial(self.values, where=where))))
            if len(expanded) > MOST_VALUES:
                raise ComArmorError(f"the tunable has more than the {MOST_VALUES:,} values allowed", code="tunable")
        self.spend(expanded)
        self.own[name] = Tunable(name, tuple(expanded), where)
        self.budget.tunables.setdefault(self.own[name].key, self.own[name])

    def values(self, name: str, where: Origin) -> tuple[Value, ...]:
        """Return the values of a tunable for a use in a place.

        Raises:
            ComArmorError: it is not declared above, in this or an enclosing scope.
        """
        passed: list[TunableScope] = []
        scope: TunableScope | None = self
        while scope is not None:
            if tunable := scope.own.get(name):
                self.budget.used_tunables.add(tunable.key)
                for inner in passed:
                    inner.passed.setdefault(name, (tunable, where))
                return tunable.values
            passed.append(scope)
            scope = scope.outer
        known = dict.fromkeys(known for scope in passed for known in scope.own)
        help_ = did_you_mean(name, known, "declare it with <tunable> above its use")
        raise _tunable_error(name, "is unknown here", None, help_)

    def expand(self, text: str, where: Origin) -> tuple[Value, ...]:
        """Return the expansions of an attachment.

        Raises:
            ComArmorError: the notation is wrong, a tunable is unknown, or there are too many expansions.
        """
        bare = strip(text)
        expanded = dict.fromkeys(expand(parse(bare), partial(self.values, where=where)))
        self.spend(expanded)
        return tuple(expanded)

    def spend(self, values: dict[Value, None]) -> None:
        """Count the characters of expanded values.

        Raises:
            ComArmorError: the policy exceeds its limit.
        """
        self.budget.used += sum([sum(map(len, value)) for value in values])
        if self.budget.used > MOST_EXPANDED_CHARACTERS:
            most = f"{MOST_EXPANDED_CHARACTERS:,} characters"
            raise ComArmorError(f"the expanded tunables have more than the {most} allowed", code="tunable")
