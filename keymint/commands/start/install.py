# SPDX-License-Identifier: Apache-2.0
"""``keymint install``: sign built documents and stage enclaves."""

from __future__ import annotations

from collections.abc import Iterator

import click

from keymint.command_line.agreement import confirmed_plan
from keymint.command_line.options import Names, install_request, names_group, standard_option
from keymint.command_line.verb import Report, Run, findings_exit, verb
from keymint.commands.start.build import no_packages
from keymint.errors import Diagnostic, ExitCode
from keymint.run.run import exit_code_of
from keymint.stages.create import UNCREATED, policy_changed, subjects_without_package
from keymint.stages.pipeline import INSTALL, Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session


@verb(jobs=True, dry_run=True, yes=True)
def install(
    run: Run,
    names: Names = names_group(),
    request: InstallRequest = install_request(allow_vendor_specific=standard_option),
) -> Report:
    """Sign the documents in build/ and stage them in install/, one complete enclave per subject.

    Nothing is installed unless each document is proven to permit exactly what the policy allows, for all names; see
    'keymint prove --help'. Unchanged certificates and signed documents are kept. Each enclave can be copied to a robot
    by itself; private keys of authorities are never staged. NAME is a package [all].
    """
    run.shown_notes = (UNCREATED,)
    if names and request.new_authority:
        raise click.UsageError("--new-authority applies to all enclaves; do not name packages.")

    def exit_code(plan: Plan) -> ExitCode:
        nothing = findings_exit([finding for finding in plan.diagnostics if finding.code == UNCREATED])
        return exit_code_of(plan) or nothing

    def make_plan(session: Session) -> Plan:
        chosen = names.packages(run, session)

        def notes(_: Work) -> Iterator[Diagnostic]:
            yield from policy_changed(session) if chosen or names else (no_packages(session),)
            if not names and (not chosen or request.prove):
                yield from subjects_without_package(session, lazy_policy(session), chosen)

        asked = request.resumed(resumes=run.resumes)
        policy = lazy_policy(session) if request.prove else None
        installation = Request(chosen, (INSTALL,), asked, policy=policy, follow=False, notes=notes)
        return confirmed_plan(run, conduct(Work(session), installation, run.crew))

    return run.change(make_plan, exit_code)
