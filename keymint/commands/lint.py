# SPDX-License-Identifier: Apache-2.0
"""``keymint lint``: reports unreachable, redundant and suspicious rules of a policy."""

from __future__ import annotations

from pathlib import Path

import click

from comarmor.text import counted
from keymint.analysis.lint import CODES, sorted_diagnostics
from keymint.analysis.lint import lint as look
from keymint.analysis.portability import portability
from keymint.analysis.subject_patterns import pattern_examples, rules_of
from keymint.api import RuleCheck
from keymint.commands.options import FILE, PATH, PluginOption, PolicyOptions, policy_options
from keymint.commands.policies import Policies
from keymint.commands.run import Run
from keymint.commands.user_files import write_outputs
from keymint.commands.verb import verb
from keymint.errors import ExitCode, KeymintError
from keymint.output.report import Report, findings_exit
from keymint.output.sarif import of_diagnostics
from keymint.output.sarif import sarif as sarif_log


@verb()
@click.argument("policy", required=False, type=PATH)
@click.option("--sarif", type=FILE, metavar="FILE", help="Write SARIF 2.1.0.")
@click.option(
    "--build-type",
    cls=PluginOption,
    group="keymint.build_types",
    default="keymint_ros2_dds",
    show_default=True,
    help="Plugin that compiles the rules.",
)
@policy_options
def lint(
    run: Run,
    policy: Path | None,
    sarif: Path | None,
    build_type: str,
    policy_options: PolicyOptions,
) -> Report:
    """Report unreachable, redundant and suspicious rules of POLICY.

    \b
    unreachable and redundant rules; DENY rules that deny nothing
    attachments that match no subject or object; profiles that never apply
    unused tunables; names that differ by a likely typing error
    rules that cannot be expressed portably across DDS vendors

    POLICY is a ComArmor file or directory, or a workspace [the current workspace]. A finding is true for all names and
    for every subject of the rule. Exit code 3: there are findings.
    """
    policies = Policies(run, policy_options)
    loaded = policies.load(policy)
    named = loaded.subjects()
    others = {like: subject for subject, like in pattern_examples(loaded).items()}
    subjects = [(subject, rules_of(loaded, subject)) for subject in (*named, *others.values())]
    compiler = run.plugins.build_type(build_type)
    if not isinstance(compiler, RuleCheck):
        raise KeymintError(
            f"the build type {build_type} cannot check rules alone",
            help="'keymint build' reports what it cannot express",
            code="plugin-unsuitable",
            exit_code=ExitCode.USAGE,
        )
    diagnostics = [
        *look(loaded),
        # lint already reports names that nothing can have.
        *(
            diagnostic
            for diagnostic in portability(compiler, policies.distro, subjects)
            if diagnostic.code != "never-matches"
        ),
    ]
    diagnostics = sorted_diagnostics(diagnostics)
    if sarif is not None:
        write_outputs(run, sarif, sarif_log("keymint lint", CODES, of_diagnostics(diagnostics), run.typed))
    number = len(diagnostics)
    like = f" and {counted(len(others), 'pattern')} of subjects" if others else ""
    run.console.line(f"{counted(number, 'finding')} in the rules of {counted(len(named), 'subject')}{like}")
    result = {"subjects": list(named), "findings": number}
    return Report(run.verb, None, (), diagnostics, result, findings_exit(diagnostics))
