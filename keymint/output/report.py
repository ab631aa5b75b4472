"""The outcome of a verb."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.changes import Step
from keymint.errors import ExitCode
from keymint.workspace import Workspace, shown


@dataclass(frozen=True, slots=True)
class Report:
    """What a verb did.

    Attributes:
        verb: its name.
        workspace: the workspace, or None for a verb that needs none or found none.
        steps: what was done, or would be.
        diagnostics: warnings, findings and errors.
        result: what else the verb has to say; its shape is the verb's.
        exit_code: what the process ends with.
        dry_run: nothing was written.
    """

    verb: str
    workspace: Workspace | None = None
    steps: Sequence[Step] = ()
    diagnostics: Sequence[Diagnostic] = ()
    result: Mapping[str, Any] = field(default_factory=dict)
    exit_code: ExitCode = ExitCode.DONE
    dry_run: bool = False


def as_typed(diagnostic: Diagnostic, folder: Path) -> Diagnostic:
    """Return a diagnostic with the paths in it as a user who stands in a folder would type them."""
    prefix = f"{folder}/"

    def place(origin: Origin) -> Origin:
        file = shown(Path(origin.file), folder) if origin.file.startswith("/") else origin.file
        return replace(origin, file=file, chain=tuple(map(place, origin.chain)))

    return replace(
        diagnostic,
        where=place(diagnostic.where) if diagnostic.where else None,
        message=diagnostic.message.replace(prefix, ""),
        help=diagnostic.help.replace(prefix, ""),
    )


def folded(diagnostics: Sequence[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Fold diagnostics that differ in their subject only: a defect in shared defaults is one defect.

    The message then says for how many packages it stands. Diagnostics without a place stay as they are.
    """
    together: dict[Diagnostic, int] = {}
    first: dict[Diagnostic, Diagnostic] = {}
    seen: set[Diagnostic] = set()
    for diagnostic in diagnostics:
        if diagnostic.subject and diagnostic in seen:
            continue  # two stages say the same of one package
        seen.add(diagnostic)
        key = replace(diagnostic, subject="") if diagnostic.where else diagnostic
        together[key] = together.get(key, 0) + 1
        first.setdefault(key, diagnostic)
    return tuple(
        first[key] if count == 1 or not key.where else replace(key, message=f"{key.message} [{count} packages]")
        for key, count in together.items()
    )


def findings_exit(diagnostics: Sequence[Diagnostic]) -> ExitCode:
    """Return the exit code of a verb that looks for findings: notes are none."""
    found = any(diagnostic.severity is not Severity.NOTE for diagnostic in diagnostics)
    return ExitCode.FINDINGS if found else ExitCode.DONE
