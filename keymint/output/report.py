# SPDX-License-Identifier: Apache-2.0
"""The outcome of a verb, and its JSON, which ``docs/json.md`` describes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from comarmor.text import lazy_regex
from comarmor.values import Data, field, replace, values_of
from keymint.errors import Diagnostic, ExitCode, Severity
from keymint.store.changes import Step
from keymint.workspace.workspace import Workspace

FORMAT = "keymint-report"
VERSION = 2
FEW = 10
"""So many messages or steps that are alike are shown one by one."""
_NAMES = lazy_regex(r"(?:(?:'[^']*'|\S*[/\d]\S*)[,;]?\s*)+")
"""What differs between messages that say the same: quoted words, paths, names of ROS, and numbers."""
_T = TypeVar("_T", Diagnostic, Step, str)


class Report(Data):
    """The outcome of a verb.

    Attributes:
        verb: its name.
        workspace: the workspace, or None.
        steps: the steps that were executed, or would be.
        diagnostics: warnings, findings and errors.
        result: further results; each verb has its own keys.
        exit_code: exit code of the process.
        dry_run: whether nothing was written.
        notes: whether notes belong to the result, and are shown unless quiet; else only if verbose. Or the codes of
            those that do.
    """

    verb: str
    workspace: Workspace | None = None
    steps: Sequence[Step] = ()
    diagnostics: Sequence[Diagnostic] = ()
    result: Mapping[str, Any] = field(default_factory=dict)
    exit_code: ExitCode = ExitCode.DONE
    dry_run: bool = False
    notes: bool | Collection[str] = False


def merged_diagnostics(diagnostics: Sequence[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Merge diagnostics that differ only in their subject: a defect in shared defaults is one defect.

    The message then ends with the number of packages. Diagnostics without a place are not merged.
    """
    together: dict[Diagnostic, list[Diagnostic]] = {}
    seen: set[Diagnostic] = set()
    for diagnostic in diagnostics:
        if diagnostic.subject and diagnostic in seen:
            continue  # two stages report the same for one package
        seen.add(diagnostic)
        key = replace(diagnostic, subject="") if diagnostic.where else diagnostic
        together.setdefault(key, []).append(diagnostic)
    return tuple(
        same[0] if len(same) == 1 or not key.where else replace(key, message=f"{key.message} [{len(same)} packages]")
        for key, same in together.items()
    )


def rolled_up(items: Sequence[_T]) -> Iterator[tuple[_T, int]]:
    """Yield items, each with the number of those that it stands for; where more than :data:`FEW` are alike, the first.

    A fleet so prints as few lines as a robot. Of errors, which somebody must mend, the first :data:`FEW` are yielded.

    Args:
        items: diagnostics, steps or lines, in the order in which they are shown.
    """
    kinds = [_kind(each) for each in items]
    numbers, seen = Counter(kinds), Counter[tuple[str, str, str]]()
    for item, own in zip(items, kinds, strict=True):
        seen[own] += 1
        most = FEW if own[1] == Severity.ERROR or numbers[own] <= FEW else 1
        if seen[own] <= most:
            yield item, numbers[own] - most + 1 if seen[own] == most < numbers[own] else 1


def _kind(item: Diagnostic | Step | str) -> tuple[str, str, str]:
    """Return what is equal for items that are alike: what they are called, and their words without names."""
    if isinstance(item, Step):
        return item.stage, item.action, _without_names(item.detail, item.package)
    if isinstance(item, str):
        return "", "", _without_names(item, "")
    return item.code, item.severity, _without_names(item.message, item.subject)


def _without_names(text: str, subject: str) -> str:
    name = subject.strip("/")
    return _NAMES.sub("… ", text.replace(name, "/") if name else text)


def findings_exit(diagnostics: Sequence[Diagnostic]) -> ExitCode:
    """Return the exit code of a verb that reports findings; notes do not count."""
    return findings_if(any(diagnostic.severity is not Severity.NOTE for diagnostic in diagnostics))


def findings_if(found: object) -> ExitCode:
    """Return the exit code of a verb that found something if the value is true, else of one that found nothing."""
    return ExitCode.FINDINGS if found else ExitCode.DONE


def members(value: object, *names: str) -> dict[str, Any]:
    """Return attributes of an object as members with the same names; an empty text is null."""
    found = ((name, getattr(value, name)) for name in names)
    return {name: None if each == "" else each for name, each in found}


def report_json(report: Report) -> dict[str, Any]:
    """Return the JSON document of a verb."""
    workspace = report.workspace
    return {
        "format": FORMAT,
        "version": VERSION,
        "verb": report.verb,
        "workspace": str(workspace.root) if workspace else None,
        "dry_run": report.dry_run,
        "exit_code": int(report.exit_code),
        "summary": dict(sorted(Counter(str(step.action) for step in report.steps).items())),
        "steps": [_step(step, workspace) for step in report.steps],
        "diagnostics": [diagnostic_json(diagnostic) for diagnostic in report.diagnostics],
        "result": dict(report.result),
    }


def _step(step: Step, workspace: Workspace | None) -> dict[str, Any]:
    def typed(folder: Path | str, name: str) -> str:
        return workspace.shown(f"{folder}/{name}") if workspace else f"{folder}/{name}"

    return {
        "stage": step.stage,
        "package": step.package,
        "action": str(step.action),
        "written": [typed(change.folder, name) for change in step.changes for name in change.written],
        "removed": [typed(change.folder, name) for change in step.changes for name in change.removed],
        "detail": step.detail,
        "sizes": [values_of(size) for size in step.sizes],
    }


def diagnostic_json(diagnostic: Diagnostic) -> dict[str, Any]:
    """Return a diagnostic as JSON data."""
    where = diagnostic.where
    return {
        "code": diagnostic.code,
        "severity": str(diagnostic.severity),
        "message": diagnostic.message,
        "file": where.file if where else None,
        "line": where.line or None if where else None,
        "included_from": [{"file": outer.file, "line": outer.line} for outer in (where.chain if where else ())],
        "help": diagnostic.help,
        "subject": diagnostic.subject,
    } | ({"source": where.source} if where and where.source else {})
