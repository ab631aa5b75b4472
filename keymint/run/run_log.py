# SPDX-License-Identifier: Apache-2.0
"""The log of runs: what each run that wrote to a workspace did, when, by whom, and with which version of Keymint.

It is a file of JSON lines beside the register, and becomes visible together with what the run wrote. It has the last
runs only. Nothing is decided by it, and a line that somebody damaged is left out.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from comarmor.text import encodable_value, lazy_regex
from keymint import __version__
from keymint.errors import KeymintError
from keymint.store.changes import FolderChange, Plan, secret_file
from keymint.view.tree import Tree
from keymint.workspace.session import Inputs
from keymint.workspace.workspace import Workspace

MOST_RUNS, MOST_BYTES = 1000, 1 << 18
"""The most runs in a log, and its largest size; the oldest runs go."""
_MOST_NAMES, _LONGEST = 20, 1000
"""The most packages that a line names, and the most characters of a command."""
_TEXTS = ("verb", "command", "user", "host", "version", "workspace")
_MEMBERS = {**dict.fromkeys(_TEXTS, str), "steps": dict, "names": list}
"""The members of a line beside the time, and their kinds."""
_SECRET = lazy_regex(r"(?i)((?:pin(?:-value)?|pass(?:word|phrase|wd)?|secret|token)=|://[^/@\s:]*:)[^&;?@\s'\"]+")
"""What a command may have in the URI of a token or of a server (RFC 7512, 2.3: ``pin-value``)."""


def log_change(
    inputs: Inputs, plan: Plan, verb: str, command: str, who: tuple[str, str], now: datetime
) -> tuple[FolderChange, ...]:
    """Return what adds a run to the log; nothing if it writes nothing, or if this user has no access to private files.

    Args:
        inputs: the workspace before the run.
        plan: what the run does.
        verb: its verb.
        command: what was typed.
        who: the user and the host.
        now: the clock, UTC.
    """
    workspace, private = inputs.workspace, str(inputs.workspace.private)
    writes_there = (f"{folder}/".startswith(f"{private}/") for folder, _, _ in plan.names())
    if not plan.writes() or not (os.access(private, os.W_OK | os.X_OK) or any(writes_there)):
        return ()
    try:
        lines = (inputs.tree.read(workspace.log) or b"").splitlines()[-MOST_RUNS + 1 :]
    except KeymintError:  # it is a link, or of another user: what the run was asked for comes first
        return ()
    changing = [step for step in plan.steps if step.writes()]
    entry = {
        "at": now.isoformat(),
        "verb": verb,
        "command": _SECRET.sub(r"\1***", command)[:_LONGEST],
        "user": who[0],
        "host": who[1],
        "version": __version__,
        "workspace": str(workspace.root),
        "steps": Counter(str(step.action) for step in changing),
        "names": [*dict.fromkeys(step.package for step in changing if step.package)][:_MOST_NAMES],
    }
    lines.append(json.dumps(encodable_value(entry)).encode())
    while sum(map(len, lines)) + len(lines) > MOST_BYTES:
        del lines[0]
    return (secret_file(workspace.log, b"\n".join(lines) + b"\n"),)


def logged_runs(tree: Tree, workspace: Workspace) -> list[Mapping[str, Any]]:
    """Return the runs in the log, the oldest first.

    Raises:
        KeymintError: it cannot be read.
    """
    return [run for line in (tree.read(workspace.log) or b"").splitlines() if (run := _run(line))]


def _run(line: bytes) -> Mapping[str, Any] | None:
    """Return the run in a line; None if it is none."""
    try:
        found = json.loads(line)
        moment = datetime.fromisoformat(found["at"]).astimezone(UTC)
        return {"at": moment, **{name: kind(found[name]) for name, kind in _MEMBERS.items()}}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        return None
