# SPDX-License-Identifier: Apache-2.0
"""The one door to errors, diagnostics and exit codes for Keymint and its plugins; errors of several modules."""

from __future__ import annotations

from collections.abc import Collection

from comarmor.errors import (
    ComArmorError as KeymintError,
    Defects,
    Diagnostic,
    ExitCode,
    Origin,
    Reason,
    Severity,
    Spot,
    citation,
    library_name,
    require_none,
)
from comarmor.text import did_you_mean

__all__ = [
    "Defects", "Diagnostic", "ExitCode", "KeymintError", "Origin", "Reason", "Severity", "Spot", "UnconfirmedError",
    "UnsayableError", "citation", "known_authority", "library_name", "process_ended", "require_none", "usage_error",
]  # fmt: skip


class UnsayableError(ValueError):
    """A format cannot say a rule; the message has the reason, and the exporter makes a finding of it."""


class UnconfirmedError(KeymintError):
    """A run stopped before it wrote anything, since nobody agreed to what it would take away; see ``Run.confirm``."""


def usage_error(message: str, help_: str, code: str = "usage") -> KeymintError:
    """Return an error in the arguments of the command line; its exit code is 2."""
    return KeymintError(message, help=help_, code=code, exit_code=ExitCode.USAGE)


def process_ended(code: str) -> KeymintError:
    """Return the error that a process of a run ended before its work was done, e.g. for want of memory."""
    help_ = "was it killed, or is memory short? run the command again, or with -j 1"
    return KeymintError("a process of this run ended before its work was done", help=help_, code=code)


def known_authority(name: str, known: Collection[str], where: Origin | None, job: str = "", help_: str = "") -> str:
    """Check that a profile has an authority, and return its name.

    Args:
        name: the authority's name; empty if no document gives one.
        known: names of the profile's authorities.
        where: the place that gives the name, or should give it; None if the user typed it.
        job: what the authority does, for the message about one that is not named.
        help_: what to do if no name is similar; by default the names are listed.

    Raises:
        KeymintError: there is no such authority; a usage error if ``where`` is None.
    """
    if name in known:
        return name
    raise KeymintError(
        f"there is no authority {name!r} in the profile"
        if name
        else f"no <issuer_name> names the authority that {job}",
        where=where,
        help=did_you_mean(name, known, help_ or f"the profile's authorities are {', '.join(known) or 'none'}"),
        code="authority-unknown",
        exit_code=ExitCode.FAILURE if where else ExitCode.USAGE,
    )
