# SPDX-License-Identifier: Apache-2.0
"""``keymint provision``: all stages in one step."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from comarmor.values import replace
from keymint.api import LoadedPolicy
from keymint.authority.authority_files import elsewhere
from keymint.command_line import options, stage_options
from keymint.command_line.options import DEFAULT_PROFILE_TYPE, DocumentOptions, Names, document_options, install_request
from keymint.command_line.verb import PATH, Report, Run, argument, flag, option, option_group, verb
from keymint.errors import Diagnostic, Origin
from keymint.names import no_subject, subject_of
from keymint.stages import create
from keymint.stages.pipeline import CREATE, INSTALL, Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.package_build_types import BUILD
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Inputs
from keymint.workspace.shipped_profiles import plan_release

_MOST = 20
"""Number of new packages of which this verb asks whether their nodes can start; ``check`` asks it of all."""
_SHOWN = frozenset({"node-cannot-start", "parameter-client-cannot-start", "authority-key-missing"})


@verb(jobs=True, dry_run=True, yes=True, former={"trust_package": "--accept-package"})
def provision(
    run: Run,
    policy: Path = argument(type=PATH),
    profile: stage_options.ProfileOptions = stage_options.profile_options,
    force: bool = flag("-f"),
    rekey: Names = option_group(Names, given=option("--rekey", multiple=True, metavar="NAME")),
    document_options: DocumentOptions = document_options,
    request: InstallRequest = install_request(),
    acceptance: stage_options.AcceptanceOptions = stage_options.acceptance_options,
) -> Report:
    """Turn a ComArmor POLICY into a keystore in one step: init, create --all, build and install.

    Everything is planned and validated before anything is written. Run it again after each change of the policy: only
    affected packages are rebuilt and signed, and keys are kept. Nothing is installed unless each document is proven to
    permit exactly what the policy allows, for all names.

    Options:
        force: Discard manual edits of packages' rules and of built documents.
        given: Replace the private key of NAME, or a pattern.
    """
    run.shown_notes = _SHOWN
    workspace = run.workspace_at(None)
    build = options.build_options(run, document_options)
    request = replace(request, force=force, build=build, allow_vendor_specific=build.allow_vendor_specific)
    bootstrap = stage_options.bootstrap_request(run, workspace, policy, profile)
    if workspace.exists():
        stage_options.refuse_contradiction(run, workspace, profile)

    def make_plan(inputs: Inputs) -> Plan:
        before = inputs.session() if inputs.workspace.exists() else None
        moved: Path | None = None
        if before:
            own = create.policy_path(run.setting.cwd / policy, inputs.workspace.profile)
            named = create.plan_policy(before, own)
            work, moved = Work(before).then(named), policy if named.writes() else None
        else:
            kind = profile.profile_type or DEFAULT_PROFILE_TYPE
            work = Work.after(inputs, create.plan_init(inputs, kind, bootstrap, profile.distro, run.setting.cwd))
            create.refuse_unsupported(work.session)
        work = stage_options.accept(work, acceptance)
        acquired = lazy_policy(work.session)
        work = work.then(plan_release(work.session, acquired))
        names = create.packages_to_create(work.session, acquired)
        if not names:
            raise no_subject(
                "attach a profile to a name without wildcards, or use 'keymint create NAME'", Origin(str(policy))
            )
        told: tuple[Diagnostic, ...] = ()
        new_keys: tuple[str, ...] = ()
        if rekey:
            new_keys = rekey.packages(run, work.session, names)
            told = rekey.confirm(run, "rekey", new_keys)
        unknown = stage_options.unknown_hints(
            build.hints, document_options.hints, (*names, *work.session.needed_infrastructure())
        )
        everything = Request(
            names,
            (CREATE, BUILD, INSTALL),
            replace(request, rekey=frozenset(new_keys)).resumed(resumes=run.resumes),
            policy=acquired,
            change=Plan((), work.session.state, (*told, *unknown)),
            follow=False,
            late=True,
            notes=lambda done: _notes(done, acquired, prune=request.prune),
        )
        work = conduct(work, everything, run.crew)
        if before is None or not work.plan.writes():
            run.result["rights"] = []
            return work.plan
        from keymint.command_line.agreement import another_policy, confirmed_plan  # noqa: PLC0415 - not for a new fleet

        return confirmed_plan(run, work, another_policy(run, before, acquired, moved), acquired)

    return run.carry_out(workspace, make_plan)


def _notes(work: Work, policy: LoadedPolicy, *, prune: bool) -> Iterator[Diagnostic]:
    """Yield what is told of some work: slips in the policy, nodes that cannot start, authorities without a key."""
    session, steps = work.session, work.of(CREATE, BUILD).steps
    yield from stage_options.policy_slips(session, steps, policy)
    made = [subject_of(step.package) for step in steps if step.stage == CREATE and step.writes()][:_MOST]
    written = {each: own.rules if (own := policy.rules(each)) else () for each in made}
    if doubtful := [each for each in made if not any("/rosout" in rule.expressions for rule in written[each])]:
        from keymint.examine.nodes import node_notes, of_policy  # noqa: PLC0415 - nodes with common/node.xml need none

        profile = session.profile
        yield from node_notes(session.plugins, profile.build_types, profile.distro, of_policy(policy, doubtful))
    yield from elsewhere(session)
    yield from create.other_domain(session)
    if prune:
        yield from create.not_pruned(session, policy, {each.subject for each in work.plan.diagnostics})
