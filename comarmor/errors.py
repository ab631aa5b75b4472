"""What can be wrong with a policy, as data: diagnostics, and the one exception that carries them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum


class Severity(StrEnum):
    """How much a diagnostic matters: an error stops the work, a warning does not."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True, slots=True, order=True)
class Location:
    """A place in a file that a person wrote.

    Attributes:
        file: path as the user would type it; never empty.
        line: line number from 1, or 0 for the file as a whole.
        chain: the places that included the file, innermost first; these have no chain of their own.
        column: column from 1, or 0 if it is not known. It tells apart what stands on one line.
    """

    file: str
    line: int = 0
    chain: tuple[Location, ...] = ()
    column: int = 0

    def __str__(self) -> str:
        """Return ``file:line``, followed by the chain of includes."""
        place = f"{self.file}:{self.line}" if self.line else self.file
        return "".join([place, *(f", included from {outer}" for outer in self.chain)])


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One defect of a policy.

    Attributes:
        code: stable identifier in kebab-case, e.g. ``include-outside``.
        severity: error or warning.
        message: one line: what is wrong and what was expected.
        where: the place it is about, if there is one.
        help: one line: how to mend it; may be empty.
    """

    code: str
    severity: Severity
    message: str
    where: Location | None = None
    help: str = ""

    def __str__(self) -> str:
        """Return the diagnostic on one line: ``place: message (help)``."""
        place = f"{self.where}: " if self.where else ""
        return f"{place}{self.message}" + (f" ({self.help})" if self.help else "")


class ComArmorError(Exception):
    """A policy cannot be used; says why as diagnostics, never as a traceback.

    Args:
        message: one line for the user.
        where: the place it is about.
        help: one line: how to mend it.
        code: stable identifier in kebab-case.
    """

    def __init__(
        self,
        message: str,
        *,
        where: Location | None = None,
        help: str = "",  # noqa: A002 - the field's name for the last part of a message
        code: str = "policy",
    ) -> None:
        self.diagnostics: tuple[Diagnostic, ...] = (Diagnostic(code, Severity.ERROR, message, where, help),)
        super().__init__(str(self.diagnostics[0]))

    @classmethod
    def of(cls, diagnostics: Iterable[Diagnostic]) -> ComArmorError:
        """Return an error that carries several diagnostics (at least one)."""
        listed = tuple(diagnostics)
        first = listed[0]
        error = cls(first.message, where=first.where, help=first.help, code=first.code)
        error.diagnostics = listed
        return error


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """Return ``did you mean …?`` with the nearest known word, or an empty string when none is near."""
    near = get_close_matches(word[:64], known, n=1)
    return f"did you mean {near[0]}?" if near else ""


def quoted(text: str, limit: int = 60) -> str:
    """Return text on one line, in quotes, cut to a length at which a message can still be read."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[: limit + 1])
    return f"'{shown[:limit]}…'" if len(shown) > limit else f"'{shown}'"
