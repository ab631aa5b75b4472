"""What can go wrong, as data: diagnostics, and the one exception that carries them to the user."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum

from comarmor.errors import Diagnostic, Origin, Severity


class ExitCode(IntEnum):
    """Exit codes of the command line."""

    DONE = 0
    FAILURE = 1
    USAGE = 2
    FINDINGS = 3
    INTERRUPTED = 130
    TERMINATED = 143


class KeymintError(Exception):
    """The work cannot be done; says why as diagnostics, never as a traceback.

    Args:
        message: one line for the user.
        where: the place it is about.
        help: one line: how to mend it.
        code: stable identifier in kebab-case.
        exit_code: the exit code that the command line ends with.
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
        self.diagnostics: tuple[Diagnostic, ...] = (Diagnostic(code, Severity.ERROR, message, where, help),)
        self.exit_code = exit_code
        super().__init__(str(self.diagnostics[0]))

    @classmethod
    def of(cls, diagnostics: Iterable[Diagnostic], exit_code: ExitCode = ExitCode.FAILURE) -> KeymintError:
        """Return an error that carries several diagnostics (at least one)."""
        listed = tuple(diagnostics)
        first = listed[0]
        error = cls(first.message, where=first.where, help=first.help, code=first.code, exit_code=exit_code)
        error.diagnostics = listed
        return error
