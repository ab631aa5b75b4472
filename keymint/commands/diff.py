"""``keymint diff``: compare two policies by meaning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from comarmor.errors import Diagnostic, Origin, Severity, library_name
from keymint.analysis.policy_diff import diff_policies as compare
from keymint.analysis.policy_diff import has_gains
from keymint.analysis.query_budget import STATES, QueryBudget
from keymint.api import LoadedPolicy
from keymint.commands.options import PolicyOptions, policy_options
from keymint.commands.policies import Policies, place, typed
from keymint.commands.run import Run
from keymint.commands.verb import verb
from keymint.errors import ExitCode, KeymintError
from keymint.git import at_revision, is_revision
from keymint.output.console import Console
from keymint.output.differences import as_text, summary
from keymint.output.json import differences_json
from keymint.output.markdown import markdown
from keymint.output.report import Report

_UNKNOWN = Diagnostic(
    "diff-unknown",
    Severity.WARNING,
    "the policies were not compared in full",
    help="raise --budget, compare parts of the policies by themselves, or ask 'keymint query can' for one subject",
)
FORMATS = ("text", "markdown", "json")


@verb(workspace=False)
@click.argument("old", metavar="A")
@click.argument("new", metavar="B")
@click.option("-f", "--format", "kind", type=click.Choice(FORMATS), default="text", show_default=True)
@click.option(
    "--budget", default=STATES, show_default=True, metavar="STATES", type=click.IntRange(1), help="States to search."
)
@policy_options
def diff(run: Run, old: str, new: str, kind: str, budget: int, policy_options: PolicyOptions) -> Report:
    """Compare the policies A and B: list what each subject gains and loses, for all names.

    A and B are ComArmor files or directories, workspaces, or any of these at a Git revision: REV:PATH. 'equivalent'
    is proven for all subjects, including those that neither policy names. Subjects that profiles match by a pattern
    are listed as that pattern, with an example.

    Exit code 3: a subject gains a permission, or may gain one where the answer is unknown. Use it to guard a merge.

    \b
    keymint diff old.xml new.xml
    keymint diff HEAD~1:policy policy --format markdown
    """
    if kind == "json":
        run.console = Console(run.setting.streams, as_json=True)
    policies = Policies(run, policy_options)
    with ExitStack() as stack:
        trees: dict[str, str] = {}
        one, other = (_loaded(run, policies, text, stack, trees) for text in (old, new))
        found = compare(one, other, QueryBudget(budget))
        library = _libraries(policies, [each for each in (old, new) if not is_revision(each, run.setting.cwd)])

    def said(where: Origin | None) -> str:
        if where is None:
            return ""
        in_tree = where.file.startswith(tuple(trees))
        return _renamed(str(where.alone()) if in_tree else place(run, where), trees)

    lines = markdown(found, said, library, (old, new)) if kind == "markdown" else as_text(found, said)
    for line in lines:
        run.console.line(line)
    if kind != "markdown":
        run.console.line(summary(found))

    def placed(where: Origin | None) -> dict[str, Any] | None:
        if where is None:
            return None
        in_tree = where.file.startswith(tuple(trees))
        return {"file": _renamed(where.file if in_tree else typed(run)(where.file), trees), "line": where.line or None}

    result = {"equivalent": not found, "subjects": differences_json(found, placed)}
    doubts = [_UNKNOWN] if any(change.unknown for each in found for change in each.changes) else []
    return Report(run.verb, None, (), doubts, result, ExitCode.FINDINGS if has_gains(found) else ExitCode.DONE)


def _libraries(policies: Policies, paths: Sequence[str]) -> Callable[[str], str | None]:
    """Return a function from a file to its name in the library of any of some policies, or None."""
    each = [library_name, *(policies.library(Path(path)) for path in paths)]
    return lambda file: next((name for library in each if (name := library(file))), None)


def _loaded(run: Run, policies: Policies, text: str, stack: ExitStack, trees: dict[str, str]) -> LoadedPolicy:
    """Return the policy that an argument names, and record the name that the user knows a temporary directory by."""
    if not is_revision(text, run.setting.cwd):
        return policies.load(Path(text))
    found = stack.enter_context(at_revision(text, run.setting.cwd, run.setting.environment))
    trees[f"{found.root}/"] = f"{found.name}:"
    try:
        return policies.load(found.path)
    except KeymintError as error:
        renamed = [_as_known(diagnostic, trees) for diagnostic in error.diagnostics]
        raise KeymintError.of(renamed, error.exit_code) from None


def _as_known(found: Diagnostic, trees: dict[str, str]) -> Diagnostic:
    where = found.where.with_files(lambda file: _renamed(file, trees)) if found.where else None
    message, help_ = (_renamed(text, trees) for text in (found.message, found.help))
    return Diagnostic(found.code, found.severity, message, where, help_, found.subject)


def _renamed(text: str, trees: dict[str, str]) -> str:
    for folder, name in trees.items():
        text = text.replace(folder, name)
    return text
