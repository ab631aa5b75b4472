"""``keymint lint``: reports unreachable, redundant and suspicious rules of a policy."""

from __future__ import annotations

from pathlib import Path

import click

from comarmor.text import counted
from keymint.analysis.lint import CODES, sorted_diagnostics
from keymint.analysis.lint import lint as look
from keymint.analysis.portability import portability
from keymint.analysis.subject_patterns import pattern_examples, rules_of
from keymint.commands.options import PluginOption, PolicyOptions, policy_options
from keymint.commands.policies import Policies, typed
from keymint.commands.run import Run
from keymint.commands.user_files import write_outputs
from keymint.commands.verb import verb
from keymint.output.report import Report, findings_exit
from keymint.output.sarif import of_diagnostics
from keymint.output.sarif import sarif as sarif_log

_PATH = click.Path(path_type=Path)


@verb()
@click.argument("policy", required=False, type=_PATH)
@click.option("--sarif", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", help="Write SARIF 2.1.0.")
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
    rules that nothing is left of, or that add nothing; denials that deny nothing
    attachments that no subject or object can match; profiles that never apply
    tunables that nothing uses; names that are nearly, but not quite, alike
    rules that cannot be compiled so that every vendor of DDS reads them alike

    POLICY is a ComArmor file or folder, or a workspace; by default the policy of the workspace. A finding holds for all
    names there are, and for every subject that the rule applies to. Ends with 3 when there is any.
    """
    policies = Policies(run, policy_options)
    loaded = policies.load(policy)
    named = loaded.subjects()
    others = {like: subject for subject, like in pattern_examples(loaded).items()}
    subjects = [(subject, rules_of(loaded, subject)) for subject in (*named, *others.values())]
    compiler = run.plugins.build_type(build_type)
    found = [
        *look(loaded),
        # What the compiler says of names that nothing has is said already, and better.
        *(
            each
            for each in portability(compiler, build_type, policies.distro, subjects, run.setting.now)
            if each.code != "never-matches"
        ),
    ]
    found = sorted_diagnostics(found)
    if sarif is not None:
        write_outputs(run, sarif, sarif_log("keymint lint", CODES, of_diagnostics(found), typed(run)))
    number = len(found)
    like = f" and {counted(len(others), 'pattern')} of subjects" if others else ""
    run.console.line(f"{counted(number, 'finding')} in the rules of {counted(len(named), 'subject')}{like}")
    result = {"subjects": list(named), "findings": number}
    return Report(run.verb, None, (), found, result, findings_exit(found))
