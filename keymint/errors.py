# SPDX-License-Identifier: Apache-2.0
"""The error type and the exit codes, under the names that Keymint and its plugins use; an error of several modules."""

from comarmor.errors import ComArmorError as KeymintError
from comarmor.errors import ExitCode

__all__ = ["ExitCode", "KeymintError", "process_ended"]


def process_ended(code: str) -> KeymintError:
    """Return the error that a process of a run ended before its work was done, e.g. for want of memory."""
    return KeymintError(
        "a process of this run ended before its work was done",
        help="was it killed, or is memory short? run the command again, or with -j 1",
        code=code,
    )
