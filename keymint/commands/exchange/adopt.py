# SPDX-License-Identifier: Apache-2.0
"""``keymint adopt``: a keystore that another tool made becomes a workspace."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import click

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.adoption.adopted_workspace import Adoption, plan_adoption
from keymint.adoption.keystore_files import found_in
from keymint.adoption.keystore_policy import AdoptedPolicy, Compared, document_comparisons
from keymint.api import Bootstrap, FoundKeystore, KeystoreFiles, KeystoreReader
from keymint.command_line.options import (
    DEFAULT_DISTRO,
    DEFAULT_PROFILE_TYPE,
    PATH,
    PluginOption,
    PolicyOptions,
    distro_option,
)
from keymint.command_line.verb import verb
from keymint.commands.exchange.adopted_policy import STATES, learned_policy, named_policy
from keymint.errors import ExitCode, KeymintError
from keymint.examine.nodes import NODE_NOTES, node_notes, of_documents
from keymint.output.keystores import as_json, summary
from keymint.output.report import Report, findings_exit
from keymint.run.run import Run
from keymint.stages.proof.proof_results import ProofEffort
from keymint.store.changes import Plan
from keymint.workspace.session import Inputs
from keymint.workspace.workspace import Workspace

_OLD = "eloquent"
"""The distribution of a keystore in the layout before Foxy, if none is named."""


@verb(dry_run=True)
@click.argument("keystore", type=PATH)
@click.argument("policy", type=PATH, required=False)
@click.option("--apply", "applied", is_flag=True, help="Write the workspace; without it nothing is written.")
@click.option("--accept", is_flag=True, help="Take POLICY as it reads where the other tool enforces something else.")
@click.option(
    "--implicit/--no-implicit",
    default=True,
    show_default=True,
    help="POLICY of another tool has the rules that this tool adds by itself.",
)
@distro_option
@click.option(
    "--profile-type", cls=PluginOption, group="keymint.profile_types", default=DEFAULT_PROFILE_TYPE, show_default=True,
    help="Plugin that makes the profile.",
)  # fmt: skip
def adopt(
    run: Run,
    keystore: Path,
    policy: Path | None,
    applied: bool,
    accept: bool,
    implicit: bool,
    distro: str | None,
    profile_type: str,
) -> Report:
    """Examine KEYSTORE, which another tool made, and take it over: 'ros2 security', openssl, or a vendor's guide.

    \b
    keymint adopt demo_keystore policy.xml                      reads both, and writes nothing
    keymint adopt demo_keystore policy.xml --apply -w my_ws     makes a workspace; KEYSTORE stays as it is
    keymint adopt demo_keystore --apply -w my_ws                the same with a policy that is made from what is signed

    For each enclave: whether its certificate, key and signed documents belong together, how they compare with POLICY,
    until when they are good, and who can read its key. No link is followed that leads out of KEYSTORE.

    With --apply, the workspace has the same authorities, keys, certificates and signed documents. The next build and
    install change nothing that robots have; if they would, nothing is written. Exit code 3: there are findings.
    """
    workspace, folder = run.workspace_at(None), run.setting.cwd / keystore
    build_type_name, reader, files, found = found_in(run.plugins, folder, str(keystore), run.setting.now)
    chosen = distro or run.setting.environment.get("ROS_DISTRO") or (_OLD if found.layout == "flat" else "")
    options = PolicyOptions(chosen or None, profile_type, "keymint_ros2_comarmor")
    own, comparisons = _policy(run, reader, found, policy, workspace, options, (accept, implicit))
    different = [each for each in (one.finding() for one in comparisons) if each]
    target = options.distro or DEFAULT_DISTRO
    rules = of_documents(reader, files, found.enclaves, target)
    nodes = node_notes(run.plugins, (build_type_name,), target, rules)
    found = replace(found, diagnostics=(*found.diagnostics, *(own.diagnostics if own else ()), *different, *nodes))
    run.console.lines(summary(str(keystore), found, {each.subject: each.words for each in comparisons}))
    result = as_json(found, {each.subject: each.as_json() for each in comparisons})
    if not applied:
        return run.report(result, found.diagnostics, findings_exit(found.diagnostics), notes=NODE_NOTES)
    run.recover(workspace)
    if run.resumes:
        return replace(run.finish(workspace), result=result)
    _refuse(run, files, found, workspace)
    if own is None:
        own = learned_policy(run, reader, files, found, workspace, options)
        found = replace(found, diagnostics=(*found.diagnostics, *own.diagnostics))
    request = _request(workspace, found, own.path, files.now, target)
    adoption = Adoption(reader, files, found, own, profile_type, request)
    left = tuple(_left(found, str(keystore), workspace))
    notes = [each for each in found.diagnostics if each.severity is not Severity.ERROR]

    def make_plan(inputs: Inputs) -> Plan:
        plan = plan_adoption(inputs, adoption, run.crew)
        return replace(plan, diagnostics=(*notes, *plan.diagnostics, *left))

    return replace(run.carry_out(workspace, make_plan), result=result, notes=NODE_NOTES)


def _policy(
    run: Run, reader: KeystoreReader, found: FoundKeystore, policy: Path | None, workspace: Workspace,
    options: PolicyOptions, reading: tuple[bool, bool],
) -> tuple[AdoptedPolicy | None, tuple[Compared, ...]]:  # fmt: skip
    """Return the policy, if there is one, and how the signed documents compare with it."""
    if policy is None:
        return None, ()
    own = named_policy(run, policy, workspace, options, [each.subject for each in found.enclaves], *reading)
    effort = ProofEffort(run.setting.monotonic, STATES)
    return own, document_comparisons(reader, found.enclaves, own.rules, options.distro or DEFAULT_DISTRO, effort)


def _request(workspace: Workspace, found: FoundKeystore, policy: str, now: datetime, distro: str) -> Bootstrap:
    """Return what the new profile is to say."""
    names = {each.name for each in found.authorities}
    return Bootstrap(
        name=workspace.root.name or "workspace",
        policy=policy,
        distro=distro,
        # The domain of the first enclave that has one; others state theirs in their own sources.
        domain=next((each.domains[0].first for each in found.enclaves if each.domains), 0),
        layout=found.layout,
        subject_format=found.subject_format or "unique",
        now=now,
        authority=found.authorities[0].name if len(names) == 1 else "",
    )


def _refuse(run: Run, files: KeystoreFiles, found: FoundKeystore, workspace: Workspace) -> None:
    """Refuse to take over what is not sound, or into a place that is taken.

    Raises:
        KeymintError: something is in the way; with all of it.
    """
    errors = [each for each in found.diagnostics if each.severity is Severity.ERROR]
    if errors:
        raise KeymintError.of(found.diagnostics, ExitCode.FAILURE)
    if workspace.exists():
        raise KeymintError(
            "there is a workspace already", where=workspace.origin(workspace.profile),
            help="name another folder with -w", code="workspace-exists",
        )  # fmt: skip
    keystore = (run.setting.cwd / files.folder).resolve()
    if workspace.root.is_relative_to(keystore) or keystore.is_relative_to(workspace.install):
        raise KeymintError(
            "the workspace would lie in the keystore, or the keystore in its install space",
            where=workspace.origin(workspace.root), help="name a folder beside it with -w", code="space-overlap",
        )  # fmt: skip


def _left(found: FoundKeystore, keystore: str, workspace: Workspace) -> Iterator[Diagnostic]:
    """Yield a warning for each private key of an authority that is left where robots' files are taken from."""
    for authority in found.authorities:
        own = workspace.shown(workspace.authority_key(authority.name))
        for path in authority.key_files:
            message = f"is the private key of the authority {authority.name!r}, which {own} has now"
            help_ = f"remove it once robots get their files from {workspace.shown(workspace.install)}; keep a backup"
            yield Diagnostic.warning("adopt-key-left", message, Origin(f"{keystore}/{path}"), help_)
