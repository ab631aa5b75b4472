# SPDX-License-Identifier: Apache-2.0
"""What a worker of a cluster carries out: a request as bytes, answered as bytes."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Sequence
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint import __version__
from keymint.api import Environment
from keymint.api.plugin_loader import Plugins
from keymint.errors import ExitCode, KeymintError
from keymint.executors import answers
from keymint.executors.pool import Work

DONE, REFUSED = b"+", b"-"
"""How an answer begins."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a worker has no result.

    Attributes:
        diagnostics: the errors of the work.
        exit_code: its exit code.
        versions: what the worker has installed, if the user has something else.
    """

    diagnostics: tuple[Diagnostic, ...] = ()
    exit_code: ExitCode = ExitCode.FAILURE
    versions: str = ""


def versions(plugins: Plugins) -> str:
    """Return what must be the same here and on a worker, a line each."""
    return f"keymint/{__version__}\n{plugins.versions}"


def result_of(work: Work[Any, Any], answer: object, installed: str) -> Any:
    """Return the result in the answer to a request.

    Raises:
        KeymintError: the work failed, the worker has other versions, or the answer is none.
    """
    if isinstance(answer, bytes) and answer[:1] == DONE:
        return answers.load(answer[1:], get_type_hints(work)["return"])
    refusal: Refusal = answers.load(answer[1:] if isinstance(answer, bytes) else answer, Refusal)
    if refusal.diagnostics:
        raise KeymintError.of(refusal.diagnostics, refusal.exit_code)
    here, there = installed.splitlines(), refusal.versions.splitlines()
    raise KeymintError(
        f"a worker has {_first(there, here)}, where this machine has {_first(here, there)}",
        help="all machines need the same versions of Keymint and of its plugins",
        code="executor-version",
    )


def _first(lines: Sequence[str], others: Sequence[str]) -> str:
    return next((line for line in lines if line not in others), "nothing")


def request(work: Work[Any, Any], task: object, now: datetime, installed: str) -> bytes:
    """Return a request.

    Args:
        work: a function of a module.
        task: plain data without secrets.
        now: the clock of the run, UTC.
        installed: see :func:`versions`.
    """
    # The worker is told the versions before it reads anything that depends on them.
    return pickle.dumps((installed, now, pickle.dumps((work, task))))


def carry_out(content: bytes) -> bytes:
    """Carry out a request, and return the answer. It never raises: an exception would be pickled."""
    try:
        installed, now, inner = pickle.loads(content)  # noqa: S301 - from the user, whom a worker trusts
        plugins = _plugins(now)
        if (here := versions(plugins)) != installed:
            return REFUSED + answers.dump(Refusal(versions=here))
        work, task = pickle.loads(inner)  # noqa: S301 - the same
        return DONE + answers.dump(work(plugins, task))
    except KeymintError as error:
        return REFUSED + answers.dump(Refusal(error.diagnostics, error.exit_code))
    except Exception as error:  # noqa: BLE001 - the user gets one line for our bugs too
        failed = KeymintError(f"a worker failed: {type(error).__name__}: {error}", code="executor-failed")
        return REFUSED + answers.dump(Refusal(failed.diagnostics))


@cache
def _plugins(now: datetime) -> Plugins:
    # No transport that runs on a worker builds programs, so none needs a cache or variables.
    return Plugins(environment=Environment(now, Path(tempfile.gettempdir()), {}))
