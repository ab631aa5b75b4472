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

from comarmor.regex import lazy_regex
from comarmor.text import encodable_value
from keymint import __version__
from keymint.errors import KeymintError
from keymint.store.changes import FolderChange, Plan, secret_file
from keymint.view.tree import Tree
from keymint.workspace.session import Inputs
from keymint.workspace.workspace import Workspace

LOG = "runs.jsonl"
"""Name of the file in the private space."""
MOST_RUNS, MOST_BYTES = 1000, 1 << 18
"""The most runs in a log, and its largest size; the oldest runs go."""
_MOST_NAMES, _LONGEST = 20, 1000
"""The most packages and authorities that a line names, and the most characters of a command."""
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
    workspace = inputs.workspace
    private = str(workspace.private)
    if os.path.isdir(private):  # noqa: PTH112 - of a text
        has_access = os.access(private, os.W_OK | os.X_OK)
    else:
        has_access = any(f"{each.folder}/".startswith(f"{private}/") for each in plan.changes())
    if not has_access or not plan.writes():
        return ()
    try:
        lines = (inputs.tree.read(workspace.private / LOG) or b"").splitlines()[-MOST_RUNS + 1 :]
    except KeymintError:  # it is a link, or of another user: what the run was asked for comes first
        return ()
    entry = {
        "at": now.isoformat(),
        "verb": verb,
        "command": _SECRET.sub(r"\1***", command)[:_LONGEST],
        **dict(zip(("user", "host"), who, strict=True)),
        "version": __version__,
        "workspace": str(workspace.root),
        **_effect(plan),
    }
    lines.append(json.dumps(encodable_value(entry)).encode())
    size = 0
    for index in reversed(range(len(lines))):
        size += len(lines[index]) + 1
        if size > MOST_BYTES:
            del lines[: index + 1]
            break
    return (secret_file(workspace.private / LOG, b"\n".join(lines) + b"\n"),)


def _effect(plan: Plan) -> Mapping[str, Any]:
    """Return what a plan changes, in numbers, and the first packages and authorities that it changes."""
    changing = [step for step in plan.steps if step.writes()]
    names = dict.fromkeys(step.package for step in changing if step.package)
    counts = Counter(str(step.action) for step in changing)
    written = sum(len(each.written) for each in plan.changes())
    removed = sum(len(each.removed) for each in plan.changes())
    return {"steps": counts, "names": [*names][:_MOST_NAMES], "more": max(0, len(names) - _MOST_NAMES),
            "written": written, "removed": removed}  # fmt: skip


def logged_runs(tree: Tree, workspace: Workspace) -> list[Mapping[str, Any]]:
    """Return the runs in the log, the oldest first.

    Raises:
        KeymintError: it cannot be read.
    """
    return [run for line in (tree.read(workspace.private / LOG) or b"").splitlines() if (run := _run(line))]


def _run(line: bytes) -> Mapping[str, Any] | None:
    """Return the run in a line; None if it is none."""
    try:
        found = json.loads(line)
        moment = datetime.fromisoformat(found["at"]).astimezone(UTC)
        texts = {name: str(found[name]) for name in ("verb", "command", "user", "host", "version", "workspace")}
        steps = {str(action): int(number) for action, number in found["steps"].items()}
        names = [str(name) for name in found["names"]]
        numbers = {name: int(found[name]) for name in ("more", "written", "removed")}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        return None
    return {"at": moment, **texts, "steps": steps, "names": names, **numbers}
