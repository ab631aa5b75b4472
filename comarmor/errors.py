# SPDX-License-Identifier: Apache-2.0
"""Diagnostics with their severity and place, the error type that carries them, and the exit codes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from enum import IntEnum, StrEnum
from typing import Self, TypeVar

from comarmor.text import lazy_regex
from comarmor.values import Data, replace

_T = TypeVar("_T")
Spot = tuple[str, int, int]
"""File, line and column of a place. The line alone does not identify a rule: a minified policy is one line."""


class Severity(StrEnum):
    """Severity of a diagnostic: an error stops the work, a warning or a note does not."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


_LIBRARY = lazy_regex(
    r"(?:.*/)?(?:templates/keymint_ros|keymint_ros/_data/templates)/comarmor\.d/[a-z]+/(common/.+)", re.DOTALL
)
"""Files of the policy library that ships with Keymint, in a checkout or in an installed distribution."""


def library_name(file: str) -> str | None:
    """Return the name by which policies include a file of the shipped library, or None for any other file."""
    match = _LIBRARY.fullmatch(file) if "/comarmor.d/" in file else None
    return match[1] if match else None


def citation(file: str, line: int = 0, source: str = "") -> str:
    """Return a place for messages: ``file:line``, or for the shipped library ``common/node.xml:3 (library)``.

    Args:
        file: path.
        line: line number from 1, or 0 for the complete file.
        source: where the line comes from, see :attr:`Origin.source`; it stands before the name of the file.
    """
    name = f"{source} [{file.rpartition('/')[2]}]" if source else library_name(file)
    place = f"{name or file}:{line}" if line else name or file
    return f"{place} (library)" if name and not source else place


class Origin(Data, order=True):
    """A place in a file.

    Attributes:
        file: path as the user would type it; never empty.
        line: line number from 1, or 0 for the complete file.
        chain: the places that included the file, innermost first.
        column: column from 1, or 0 if it is not known; distinguishes elements on one line.
        source: what the file says about where this comes from, e.g. the number of a ticket; never a path.
    """

    file: str
    line: int = 0
    chain: tuple[Origin, ...] = ()
    column: int = 0
    source: str = ""

    @property
    def spot(self) -> Spot:
        """File, line and column: the same wherever the file is included from."""
        return self.file, self.line, self.column

    def included(self, chain: tuple[Origin, ...]) -> Origin:
        """Return the place in a file that other places include, innermost first."""
        return self.with_chain((*self.chain, *chain))

    def alone(self) -> Origin:
        """Return the place without the chain of includes."""
        return self.with_chain(())

    def with_chain(self, chain: tuple[Origin, ...]) -> Origin:
        """Return the place with another chain of includes; a policy has many, and the library's function is slow."""
        return Origin(self.file, self.line, chain, self.column, self.source)

    def with_files(self, rename: Callable[[str], str]) -> Origin:
        """Return the place with other names for its file and for those in the chain."""
        chain = tuple(outer.with_files(rename) for outer in self.chain)
        return replace(self, file=rename(self.file), chain=chain)

    def __str__(self) -> str:
        """Return ``file:line``, followed by the chain of includes."""
        return "".join(
            [citation(self.file, self.line, self.source), *(f", included from {outer}" for outer in self.chain)]
        )


class Reason(Data):
    """Why a request is allowed or denied, on one line.

    Attributes:
        parts: texts, and the places of rules between them.
    """

    parts: tuple[str | Origin, ...]

    def __str__(self) -> str:
        """Return the text with its places: ``the DENY rule at policy.xml:3 matches``."""
        return "".join(f" at {part}" if isinstance(part, Origin) else part for part in self.parts)

    def without_places(self) -> str:
        """Return the text alone, for outputs that show the place elsewhere: ``the DENY rule matches``."""
        return "".join(part for part in self.parts if isinstance(part, str))


class Diagnostic(Data):
    """One finding, warning or error.

    Attributes:
        code: stable identifier in kebab-case, e.g. ``portability-deny``.
        severity: error, warning or note.
        message: one line: what is wrong and what was expected.
        where: the place it applies to, if there is one.
        help: one line: how to fix it; may be empty.
        subject: the subject (enclave) it applies to, or empty.
    """

    code: str
    severity: Severity
    message: str
    where: Origin | None = None
    help: str = ""
    subject: str = ""

    @classmethod
    def error(cls, code: str, message: str, where: Origin | None = None, help: str = "", subject: str = "") -> Self:  # noqa: A002
        """Return an error; arguments as the attributes."""
        return cls(code, Severity.ERROR, message, where, help, subject)

    @classmethod
    def warning(cls, code: str, message: str, where: Origin | None = None, help: str = "", subject: str = "") -> Self:  # noqa: A002
        """Return a warning; arguments as the attributes."""
        return cls(code, Severity.WARNING, message, where, help, subject)

    @classmethod
    def note(cls, code: str, message: str, where: Origin | None = None, help: str = "", subject: str = "") -> Self:  # noqa: A002
        """Return a note; arguments as the attributes."""
        return cls(code, Severity.NOTE, message, where, help, subject)

    def __str__(self) -> str:
        """Return the diagnostic on one line: ``place: message (help)``."""
        place = f"{self.where}: " if self.where else ""
        return f"{place}{self.message}" + (f" ({self.help})" if self.help else "")


class ExitCode(IntEnum):
    """Exit codes of the command line."""

    DONE = 0
    FAILURE = 1
    USAGE = 2
    FINDINGS = 3
    INTERRUPTED = 130
    TERMINATED = 143


class ComArmorError(Exception):
    """The error type of the policy language, of Keymint and of its plugins; carries diagnostics.

    Args:
        message: one line for the user.
        where: the place it applies to.
        help: one line: how to fix it.
        code: stable identifier in kebab-case.
        exit_code: exit code of a command that fails with this error.
    """

    def __init__(
        self,
        message: str,
        *,
        where: Origin | None = None,
        help: str = "",  # noqa: A002 - the field's name for the last part of a message
        code: str = "error",
        exit_code: ExitCode = ExitCode.FAILURE,
    ) -> None:
        self.diagnostics: tuple[Diagnostic, ...] = (Diagnostic.error(code, message, where, help),)
        self.exit_code = exit_code
        super().__init__(str(self.diagnostics[0]))

    @classmethod
    def of(cls, diagnostics: Iterable[Diagnostic], exit_code: ExitCode = ExitCode.FAILURE) -> Self:
        """Return an error that carries one or more diagnostics."""
        all_of_them = tuple(diagnostics)
        error = cls("", exit_code=exit_code)
        error.diagnostics = all_of_them
        error.args = (str(all_of_them[0]),)
        return error

    def at(self, where: Origin | None) -> ComArmorError:
        """Return an error that carries the same diagnostics with another place."""
        return self.of(replace(each, where=where) for each in self.diagnostics)


def require_none(diagnostics: Iterable[Diagnostic]) -> None:
    """Raise an error that carries some diagnostics, if there are any."""
    if found := tuple(diagnostics):
        raise ComArmorError.of(found)


class Defects:
    """Collects the diagnostics of errors, to raise them together: as a context, of an error that ends its block.

    Attributes:
        found: the diagnostics.
    """

    def __init__(self) -> None:
        self.found: list[Diagnostic] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        if not isinstance(error, ComArmorError):
            return False
        self.found += error.diagnostics
        return True

    def attempt(self, make: Callable[[], _T]) -> _T | None:
        """Return the result of a function, or None if it raises an error, which is collected."""
        with self:
            return make()
        return None

    def require_none(self) -> None:
        """Raise the diagnostics, each once, if there are any."""
        require_none(dict.fromkeys(self.found))
