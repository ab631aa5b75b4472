# SPDX-License-Identifier: Apache-2.0
"""``keymint build``: unsigned documents, and keys."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from keymint.command_line.options import DocumentOptions, Names, build_options, document_options, names_group
from keymint.command_line.stage_options import policy_slips, unknown_hints
from keymint.command_line.verb import Report, Run, flag, verb
from keymint.errors import Diagnostic, KeymintError, usage_error
from keymint.stages.create import UNCREATED, policy_changed, subjects_without_package
from keymint.stages.pipeline import Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.package_build_types import BUILD
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session


@verb(jobs=True, dry_run=True, yes=True)
def build(
    run: Run,
    names: Names = names_group(),
    force: bool = flag("-f"),
    rekey: bool = flag(),
    document_options: DocumentOptions = document_options,
) -> Report:
    """Build unsigned documents in build/, and create a key for each subject that has none.

    All packages are validated before anything is written. Documents stay unsigned until 'keymint install', so you may
    edit them in between. Permissions are rewritten into a smaller form that is proven equivalent; both sizes are
    shown. NAME is a package [all].

    Options:
        force: Rebuild everything; discard manual edits.
        rekey: Replace the private keys of the packages NAME; by default keys are kept.
    """
    if rekey and not names:
        help_ = "name them: 'keymint build --rekey NAME', or '*' for all; 'keymint renew' keeps keys"
        raise usage_error("--rekey replaces private keys, and no package is named", help_)
    options = build_options(run, document_options)
    run.shown_notes = (UNCREATED,)

    def make_plan(session: Session) -> Plan:
        chosen = names.packages(run, session)
        told = names.confirm(run, "rekey", chosen) if rekey else ()

        def notes(work: Work) -> Iterator[Diagnostic]:
            yield from told
            yield from policy_changed(session) if chosen or names else (no_packages(session),)
            yield from policy_slips(session, work.plan.steps)
            with suppress(KeymintError):  # a policy that cannot be read is no matter of a build
                yield from (
                    subjects_without_package(session, lazy_policy(session), chosen) if chosen and not names else ()
                )
            yield from unknown_hints(options.hints, document_options.hints, session.packages())

        new_keys = frozenset(chosen if rekey and not run.resumes else ())
        asked = InstallRequest(force=force, rekey=new_keys, build=options)
        return conduct(Work(session), Request(chosen, (BUILD,), asked, notes=notes), run.crew).plan

    return run.change(make_plan)


def no_packages(session: Session) -> Diagnostic:
    """Return the warning that the source space has no packages."""
    message = f"no packages in {session.workspace.shown(session.workspace.src)}"
    return Diagnostic.warning("packages-none", message, None, "run 'keymint create --all'")
