# SPDX-License-Identifier: Apache-2.0
"""``keymint diff``: compare two policies by meaning."""

from __future__ import annotations

from contextlib import ExitStack
from itertools import chain
from pathlib import Path

import click

from keymint.analysis.policy_diff import diff_policies as compare, has_gains
from keymint.analysis.symbolic_search import STATES, QueryBudget
from keymint.api import LoadedPolicy
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import PolicyOptions, policy_options
from keymint.command_line.verb import Report, Run, argument, findings_if, option, verb
from keymint.errors import Diagnostic, library_name
from keymint.host.git import at_revision, is_revision
from keymint.output.console import Console
from keymint.output.differences import as_text, differences_json, markdown, summary

_UNKNOWN = Diagnostic.warning(
    "diff-unknown",
    "the policies were not compared in full",
    help="raise --budget, compare parts of the policies by themselves, or ask 'keymint query can' for one subject",
)
FORMATS = ("text", "markdown", "json")


@verb(workspace=False, former={"kind": "-f"})
def diff(
    run: Run,
    old: str = argument(metavar="A"),
    new: str = argument(metavar="B"),
    kind: str = option("--format", type=click.Choice(FORMATS), default="text", show_default=True),
    budget: int = option(default=STATES, show_default=True, metavar="STATES", type=click.IntRange(1), hidden=True),
    policy_options: PolicyOptions = policy_options,
) -> Report:
    """Compare the policies A and B: list what each subject gains and loses, for all names.

    A and B are ComArmor files or directories, workspaces, or any of these at a Git revision: REV:PATH. 'equivalent'
    is proven for all subjects, including those that neither policy names. Subjects that profiles match by a pattern
    are listed as classes, with an example; each line is true for all members of its class.

    Exit code 3: a subject gains a permission, or may gain one where the answer is unknown. Use it to guard a merge.

    \b
    keymint diff old.xml new.xml
    keymint diff HEAD~1:policy policy --format markdown

    Options:
        kind: Format of the list; markdown: for a comment on a change; json: the same as --json.
        budget: States to search.
    """
    if kind == "json":
        run.console = Console(run.setting.streams, as_json=True)
    policies = Policies(run, policy_options)
    with ExitStack() as stack:
        before, after = (_loaded(run, policies, text, stack) for text in (old, new))
        differences = compare(before, after, QueryBudget(budget))
        paths = [Path(text) for text in (old, new) if not is_revision(text, run.setting.cwd)]
        libraries = [library_name, *map(policies.library, paths)]

    def library(file: str) -> str | None:
        return next((name for each in libraries if (name := each(file))), None)

    if kind == "markdown":
        lines = markdown(differences, run.place, library, (old, new))
    else:
        lines = chain(as_text(differences, run.place), [summary(differences)])
    run.console.lines(lines)
    result = {"equivalent": not differences, "subjects": differences_json(differences, run.typed)}
    unknown = any(change.unknown for subject in differences for change in subject.changes)
    return run.report(result, [_UNKNOWN] if unknown else [], findings_if(has_gains(differences)))


def _loaded(run: Run, policies: Policies, text: str, stack: ExitStack) -> LoadedPolicy:
    """Return the policy that an argument names; the files of a revision are shown as ``REV:PATH``."""
    if not is_revision(text, run.setting.cwd):
        return policies.load(Path(text))
    name, path, root = stack.enter_context(at_revision(text, run.setting.cwd, run.setting.environment))
    run.folder_names[f"{root}/"] = f"{name}:"
    return policies.load(path, as_accepted=True)
