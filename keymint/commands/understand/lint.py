# SPDX-License-Identifier: Apache-2.0
"""``keymint lint``: reports unreachable, redundant and suspicious rules of a policy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from comarmor.text import quantity
from keymint.analysis.lint_rules import lint as look, portability, sorted_diagnostics
from keymint.analysis.subject_patterns import pattern_examples, rules_of
from keymint.api import BuildType
from keymint.command_line.named_files import write_outputs
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import PolicyOptions, policy_options
from keymint.command_line.verb import FILE, PATH, Report, Run, argument, findings_exit, path_option, plugin, verb
from keymint.errors import usage_error
from keymint.examine.nodes import NODE_NOTES, node_notes, of_policy
from keymint.ir import SubjectRules
from keymint.output.sarif import of_diagnostics, sarif as sarif_log


@verb()
def lint(
    run: Run,
    policy: Path | None = argument(required=False, type=PATH),
    sarif: Path | None = path_option(kind=FILE),
    chosen: tuple[str, ...] = plugin("keymint.build_types", "--build-type", multiple=True),
    policy_options: PolicyOptions = policy_options,
) -> Report:
    """Report unreachable, redundant and suspicious rules of POLICY.

    \b
    unreachable and redundant rules; DENY rules that deny nothing
    attachments that match no subject or object; profiles that never apply
    unused tunables; names that differ by a likely typing error
    rules that a transport cannot express, or that vendors decide differently
    subjects whose nodes cannot start with default options (as notes)

    POLICY is a ComArmor file or directory, or a workspace [the current workspace]. A finding is true for all names and
    for every subject of the rule. docs/verification.md says in one table what each verb reads.
    Exit code 3: there are findings.

    Options:
        sarif: Write SARIF 2.1.0.
        chosen: Plugin that checks the rules for its transport; may be repeated [those of the workspace, or of a new
            one].
    """
    policies = Policies(run, policy_options)
    loaded = policies.load(policy)
    named = loaded.subjects()
    others = {like: subject for subject, like in pattern_examples(loaded).items()}
    subjects = [(subject, rules_of(loaded, subject)) for subject in (*named, *others.values())]
    diagnostics = [
        *look(loaded),
        *loaded.findings,
        # lint already reports names that nothing can have.
        *(
            diagnostic
            for checker in _checkers(run, policies, chosen)
            for diagnostic in portability(checker, policies.distro, subjects)
            if diagnostic.code != "never-matches"
        ),
    ]
    number = len(set(diagnostics))
    diagnostics += node_notes(run.plugins, chosen or policies.build_types, policies.distro, of_policy(loaded, named))
    diagnostics = sorted_diagnostics(diagnostics)
    if sarif is not None:
        write_outputs(run, sarif, sarif_log("keymint lint", of_diagnostics(diagnostics), run.typed))
    like = f" and {quantity(len(others), 'pattern')} of subjects" if others else ""
    run.console.line(f"{quantity(number, 'finding')} in the rules of {quantity(len(named), 'subject')}{like}")
    result = {"subjects": named, "findings": number}
    return run.report(result, diagnostics, findings_exit(diagnostics), notes=NODE_NOTES)


def _checkers(run: Run, policies: Policies, chosen: Sequence[str]) -> Iterator[BuildType]:
    """Yield the build types that check rules: those chosen, or those of the workspace that can.

    Raises:
        KeymintError: one that was chosen checks no rules, or one is not installed.
    """
    for name in dict.fromkeys(chosen or policies.build_types):
        build_type = run.plugins.build_type(name)
        if chosen and build_type.check_rules(SubjectRules("/", ()), policies.distro) is None:
            raise usage_error(f"the build type {name} checks no rules", "'keymint build' says what it cannot express")
        yield build_type
