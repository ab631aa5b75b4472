# SPDX-License-Identifier: Apache-2.0
"""``keymint adopt``: a keystore that another tool made becomes a workspace, and what is said about it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from comarmor.text import quantity
from comarmor.values import replace
from keymint.adoption.adopted_workspace import Adoption, plan_adoption
from keymint.adoption.keystore_files import found_in
from keymint.adoption.keystore_policy import AdoptedPolicy, Compared, Learning, document_comparisons, learned_from
from keymint.api import Bootstrap, FoundEnclave, FoundKeystore, ImportRequest, KeystoreFiles
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import DEFAULT_DISTRO, PolicyOptions, distro_option, library_option
from keymint.command_line.verb import PATH, Report, Run, argument, findings_exit, flag, option, verb
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.examine.adopted_documents import policy_finding, unclear_rights
from keymint.examine.nodes import NODE_NOTES, node_notes, of_documents
from keymint.stages.create import policy_path
from keymint.stages.proof_results import ProofEffort
from keymint.store.changes import Plan
from keymint.workspace.policy_loading import foreign_policy
from keymint.workspace.session import Inputs
from keymint.workspace.workspace import Workspace

_OLD = "eloquent"
"""The distribution of a keystore in the layout before Foxy, if none is named."""
_STATES = 50_000
"""States that one search may visit."""
_FOLDER = "comarmor.d"
"""Folder of a new profile that has the policy."""


@verb(dry_run=True, former={"as_written": "--accept"})
def adopt(
    run: Run,
    keystore: Path = argument(type=PATH),
    policy: Path | None = argument(type=PATH, required=False),
    applied: bool = flag("--apply"),
    as_written: bool = flag(),
    implicit: bool = option("--implicit/--no-implicit", default=True, show_default=True),
    distro: str | None = distro_option,
    profile_type: str = library_option,
) -> Report:
    """Examine KEYSTORE, which another tool made ('ros2 security', openssl), and take it over.

    \b
    keymint adopt demo_keystore policy.xml                      reads both, and writes nothing
    keymint adopt demo_keystore policy.xml --apply -w my_ws     makes a workspace; KEYSTORE stays as it is
    keymint adopt demo_keystore --apply -w my_ws                the same with a policy that is made from what is signed

    Shows for each enclave whether its certificate, key and signed documents belong together, how they compare with
    POLICY, how long they are valid, and who can read its key. Follows no link that leads out of KEYSTORE.

    With --apply, the workspace has the same authorities, keys, certificates and signed documents. The next build and
    install change nothing that robots have; if they would, nothing is written. Exit code 3: there are findings.

    Options:
        applied: Write the workspace; without it nothing is written.
        as_written: Take POLICY as it reads where the other tool enforces something else.
        implicit: Include the rules that the tool of POLICY adds by itself.
        profile_type: Plugin that makes the profile.
    """
    workspace, folder = run.workspace_at(None), run.setting.cwd / keystore
    build_type_name, reader, files, found = found_in(run.plugins, folder, str(keystore), run.setting.now)
    chosen = distro or run.setting.environment.get("ROS_DISTRO") or (_OLD if found.layout == "flat" else "")
    options = PolicyOptions(chosen or None, profile_type, "keymint_ros2_comarmor")
    target = options.distro or DEFAULT_DISTRO
    own: AdoptedPolicy | None = None
    comparisons: tuple[Compared, ...] = ()
    effort = ProofEffort(run.setting.monotonic, _STATES)
    if policy is not None:
        own = _named_policy(run, policy, workspace, options, found, as_written=as_written, implicit=implicit)
        comparisons = document_comparisons(reader, found, own.rules, target, effort)
    different = [each for each in (policy_finding(one) for one in comparisons) if each]
    rules = of_documents(reader, files, found.enclaves, target)
    nodes = node_notes(run.plugins, (build_type_name,), target, rules)
    found = replace(found, diagnostics=(*found.diagnostics, *(own.diagnostics if own else ()), *different, *nodes))
    run.console.messages([*_summary(str(keystore), found, {each.subject: each.words for each in comparisons})])
    result = _result(found, {each.subject: each.as_json() for each in comparisons})
    if not applied:
        return run.report(result, found.diagnostics, findings_exit(found.diagnostics), notes=NODE_NOTES)
    run.recover(workspace)
    if run.resumes:
        return replace(run.finish(workspace), result=result)
    _refuse(run, files, found, workspace)
    if own is None:
        name = f"{_FOLDER}/adopted.xml"
        learning = Learning(reader, options.policy_type, target, str(workspace.profile / name), effort)
        document, granted, warnings = learned_from(run.plugins, files, found, learning, unclear_rights(found))
        learned = {each.rules.subject: each.rules for each in granted}
        own = AdoptedPolicy(_FOLDER, {name: document}, learned, tuple(learned), warnings)
        found = replace(found, diagnostics=(*found.diagnostics, *own.diagnostics))
    request = _request(workspace, found, own.path, files.now, target)
    adoption = Adoption(reader, files, found, own, profile_type, request)
    left = tuple(_left(found, str(keystore), workspace))
    notes = [each for each in found.diagnostics if each.severity is not Severity.ERROR]

    def make_plan(inputs: Inputs) -> Plan:
        plan = plan_adoption(inputs, adoption, run.crew)
        return replace(plan, diagnostics=(*notes, *plan.diagnostics, *left))

    return replace(run.carry_out(workspace, make_plan), result=result, notes=NODE_NOTES)


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
    if any(each.severity is Severity.ERROR for each in found.diagnostics):
        raise KeymintError.of(found.diagnostics)
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


def _named_policy(
    run: Run, path: Path, workspace: Workspace, options: PolicyOptions, keystore: FoundKeystore,
    *, as_written: bool, implicit: bool,
) -> AdoptedPolicy:  # fmt: skip
    """Return the policy that the user names: that of another tool is translated into the new profile.

    Args:
        run: the run.
        path: file or folder.
        workspace: the new workspace.
        options: how to read it.
        keystore: what the keystore has.
        as_written: take a policy of another tool as it reads where that tool enforces something else.
        implicit: a policy of another tool has the rules that this tool adds by itself.

    Raises:
        KeymintError: the policy is missing, has defects, or cannot be expressed.
    """
    policies, place = Policies(run, options), run.setting.cwd / path
    library = policies.shipped()  # an unknown distribution is wrong usage, whatever the file is
    foreign = foreign_policy(run.plugins, [place], options.policy_type) if place.is_file() else None
    if foreign and foreign.imported:
        name = f"{_FOLDER}/{path.name.removesuffix('.xml').removesuffix('.policy')}.xml"
        file, shown = str(workspace.profile / name), workspace.profile / _FOLDER
        request = ImportRequest(place, file, library, as_written, implicit, shown)
        imported = run.plugins.policy_type(foreign.policy_type).translated(request)
        rules = {each.rules.subject: each.rules for each in imported.subjects}
        return AdoptedPolicy(_FOLDER, {name: imported.document}, rules, tuple(rules), imported.diagnostics)
    loaded = policies.at(place, str(path), library_shown=workspace.profile / _FOLDER)
    found = {each.subject: loaded.rules(each.subject) for each in keystore.enclaves}
    rules = {subject: each for subject, each in found.items() if each is not None}
    return AdoptedPolicy(policy_path(place, workspace.profile), {}, rules, tuple(loaded.subjects()))


def _summary(keystore: str, found: FoundKeystore, relations: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of a report.

    Args:
        keystore: the keystore as the user typed it.
        found: what it has.
        relations: how the signed documents of each subject compare with a policy, in words.
    """
    yield f"{keystore}: {quantity(len(found.enclaves), 'enclave')}, {found.form}"
    for authority in found.authorities:
        facts, roles = authority.facts, " and ".join(authority.roles)
        key = f"key in {facts['key_file']}" if facts["key_file"] else "key elsewhere"
        until = f"until {str(facts['not_after'])[:10]}"
        subject = f"{facts['subject_name']}, for {roles}, {facts['key_kind']}"
        yield f"authority  {authority.name}  {subject}, {until}, {key}"
    for enclave in found.enclaves:
        yield _enclave(enclave, relations.get(enclave.subject, ""))


def _result(found: FoundKeystore, comparisons: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the result of the verb as JSON.

    Args:
        found: what the keystore has.
        comparisons: how the signed documents of each subject compare with a policy.
    """
    return {
        "form": found.form,
        "layout": found.layout or None,
        "authorities": [
            {"name": each.name, "roles": each.roles, "file": each.file, **each.facts} for each in found.authorities
        ],
        "enclaves": [
            {"subject": each.subject, **each.facts, "policy": comparisons.get(each.subject)} for each in found.enclaves
        ],
    }


def _enclave(enclave: FoundEnclave, relation: str) -> str:
    facts = enclave.facts
    certificate = facts.get("certificate")
    checks: dict[str, bool | None] = {  # each with whether it is right, if it could be checked
        "chain": bool(facts["chain"]),
        "key": None if facts["key"] == "elsewhere" else facts["key"] == "matches",
        "name": bool(facts["named_like_path"]),
        "signatures": all(facts["signatures"].values()),
        "text": None if facts["same_text"] is None else bool(facts["same_text"]),
    }
    right, wrong = (", ".join(name for name, holds in checks.items() if holds is wanted) for wanted in (True, False))
    domains = (str(first) if first == last else f"{first} to {last}" for first, last in facts["domains"] or ())
    parts = [
        facts["subject_name"] or "no certificate",
        f"until {str(certificate['not_after'])[:10]}" if certificate else "",
        f"domain {', '.join(domains)}" if facts["domains"] else "",
        relation,
        f"right: {right}" if right else "",
        f"WRONG: {wrong}" if wrong else "",
    ]
    return f"enclave    {enclave.subject or facts['place']}  {'; '.join(filter(None, parts))}"
