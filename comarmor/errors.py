"""Defects as data: diagnostics with a severity and an origin, and the exception that carries them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

Spot = tuple[str, int, int]
"""File, line and column of a place. The line alone is no key: a minified policy has all its rules on one."""


class Severity(StrEnum):
    """How much a diagnostic matters: an error stops the work, a warning and a note do not."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


_LIBRARY = re.compile(r"(?:.*/)?templates/keymint_ros/comarmor\.d/[a-z]+/(common/.+)", re.DOTALL)
"""Files of the library that ships with Keymint: in a checkout, and in an installed distribution."""


def library_name(file: str) -> str | None:
    """Return the name of a file of the shipped library, as policies include it; None of any other file."""
    found = _LIBRARY.fullmatch(file)
    return found[1] if found else None


def cited(file: str, line: int = 0) -> str:
    """Return a place as a person reads it: ``file:line``, of the shipped library ``common/node.xml:3 (library)``.

    Args:
        file: path.
        line: line number from 1, or 0 for the file as a whole.
    """
    name = library_name(file)
    place = f"{name or file}:{line}" if line else name or file
    return f"{place} (library)" if name else place


@dataclass(frozen=True, slots=True, order=True)
class Origin:
    """A place in a file that a person wrote.

    Attributes:
        file: path as the user would type it; never empty.
        line: line number from 1, or 0 for the file as a whole.
        chain: the places that included the file, innermost first.
        column: column from 1, or 0 if it is not known. It tells apart what stands on one line.
    """

    file: str
    line: int = 0
    chain: tuple[Origin, ...] = ()
    column: int = 0

    @property
    def spot(self) -> Spot:
        """File, line and column: equal for what is written in one place, however often it is included."""
        return self.file, self.line, self.column

    def alone(self) -> Origin:
        """Return the place without the chain of includes."""
        return Origin(self.file, self.line, (), self.column)

    def __str__(self) -> str:
        """Return ``file:line``, followed by the chain of includes."""
        return "".join([cited(self.file, self.line), *(f", included from {outer}" for outer in self.chain)])


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One finding, warning or error.

    Attributes:
        code: stable identifier in kebab-case, e.g. ``portability-deny``.
        severity: error, warning or note.
        message: one line: what is wrong and what was expected.
        where: the place it is about, if there is one.
        help: one line: how to mend it; may be empty.
        subject: the subject (enclave) it is about, or empty.
    """

    code: str
    severity: Severity
    message: str
    where: Origin | None = None
    help: str = ""
    subject: str = ""

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
        where: Origin | None = None,
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
