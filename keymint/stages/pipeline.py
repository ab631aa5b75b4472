# SPDX-License-Identifier: Apache-2.0
"""The order create, build, install, prove, which nothing else knows: verbs say what is different for them.

Start at :func:`conduct`. What stages changed may demand more: packages that must follow, certificates to revoke, and
revocation lists for the other enclaves.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, cast

from comarmor.values import Data, field, replace
from keymint.api import LoadedPolicy, Role, lazy
from keymint.authority.authorities import Authorities, plan_authorities
from keymint.authority.authority_files import current_rollover, trusted_chains
from keymint.errors import Diagnostic
from keymint.life.examine import RIGHTS_OUTLIVE
from keymint.life.register import SUPERSEDED
from keymint.life.revocation_lists_in_force import enclave_lists, plan_lists, require_nothing_lost
from keymint.life.workspace_register import complete_register
from keymint.names import ROOT, name_of
from keymint.pki import certificates
from keymint.stages import install
from keymint.stages.build import BuildStage, options_as_built
from keymint.stages.create import CreateStage
from keymint.stages.documents import affected_packages
from keymint.stages.install import InstallStage
from keymint.stages.proof_gate import proof_stage, proven
from keymint.stages.prove import ProofStage
from keymint.stages.work import Crew, InstallRequest, NewPackages, PackagePlan, PackageStage, Work
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.view.stamps import Stamp
from keymint.workspace.installed_enclaves import INSTALLED, enclave_names, installed_certificate, with_sources
from keymint.workspace.package_build_types import (
    BUILD,
    is_build_current,
    recorded_build_types,
    revocation_files,
    shared_type,
)
from keymint.workspace.policy_loading import policy_in_force
from keymint.workspace.session import Session, once

_plan_revocation = lazy("keymint.life.package_issuance:plan_revocation")  # few runs revoke
CREATE, INSTALL, PROVE = CreateStage.NAME, InstallStage.NAME, ProofStage.NAME
AUTHORITIES, LISTS = "authorities", "lists"
"""Parts of the work beside the stages: the keys and certificates of authorities, and their revocation lists."""


_Stages = Mapping[str, Callable[..., Any]]
"""What makes each stage for a workspace, by its name."""


class Request(Data):
    """What is different between the runs that go through the stages.

    Attributes:
        names: the packages.
        stages: the names of the stages to go through; an installation is proven, unless the options say otherwise.
        options: what the user asks for.
        policy: what is created and proven; only what is not created can do without: then it is proven against the
            policy of the workspace, with what ROS packages ship as it was accepted.
        change: what comes first: it changes the sources, the register or the authorities.
        follow: what depends on the change is issued again as well, and all other enclaves get the revocation lists.
        refresh: authorities whose revocation list is issued again in any case.
        list_end: nextUpdate of new revocation lists, UTC; the end of the authority's certificate by default.
        valid_for: length of validity that packages get in their own documents, an ISO 8601 duration.
        late: the authorities are written after the documents that they will sign.
        adopts: the keystore is that of another tool: its revocation lists stay as they are.
        beside: the keystore is not in force: nothing is revoked for it.
        checks: what is required of the work after a stage, by its name.
        notes: returns what the user is told of the work before it is proven.
    """

    names: Sequence[str]
    stages: tuple[str, ...] = (BUILD, INSTALL)
    options: InstallRequest = field(default_factory=InstallRequest)
    policy: LoadedPolicy | None = None
    change: Plan | None = None
    follow: bool = True
    refresh: Collection[str] = ()
    list_end: datetime | None = None
    valid_for: str = ""
    late: bool = False
    adopts: bool = False
    beside: bool = False
    checks: Mapping[str, Callable[[Work], None]] = field(default_factory=dict)
    notes: Callable[[Work], Iterable[Diagnostic]] = lambda _: ()


def conduct(work: Work, request: Request, crew: Crew) -> Work:
    """Return some work followed by the stages for some packages, and by what that demands of others.

    Nothing else changes. If rights become narrower and the profile or the user asks to revoke the certificates that had
    the wider ones, all is planned once more after that.

    Args:
        work: what comes before.
        request: what is asked for.
        crew: who plans packages.

    Raises:
        KeymintError: a package cannot be created, built, signed or proven, or an authority cannot sign; with all
            defects of the first stage that has any.
    """
    try:
        done = _conducted(Work(work.session), request, crew)
    finally:
        crew.new = None  # it holds the policy
    return replace(done, parts=(*work.parts, *done.parts))


def _conducted(start: Work, request: Request, crew: Crew) -> Work:
    """Return the work of :func:`conduct` that begins with a workspace as it is."""
    names = tuple(request.names)
    changed = start.then(request.change) if request.change else start
    work, authorities = _with_authorities(changed, request) if INSTALL in request.stages else (changed, {})
    if request.change and request.change.writes() and BUILD not in request.stages:
        # What the change concerns is built for it, before everything else is installed as it was built.
        concerned = _with_followers(start.session, work, [step.package for step in request.change.steps])
        as_built = partial(BuildStage, asked=InstallRequest(build=request.options.build))
        work = _through(work, as_built, concerned, request, crew)
        names = tuple(dict.fromkeys((*names, *concerned)))
    stages = _stages(request, authorities, crew)
    subjects, settled = names, frozenset[str]()
    if CREATE in stages:
        create = stages[CREATE](work.session)
        settled = _settled(work, names, create)
        subjects = create.subjects(names, settled)
    crew.new = _new_packages(work.session, subjects, stages, request)
    if PROVE in stages or not _proves(request):
        crew.start(work.session, [name for name in subjects if name not in settled], tuple(stages.values()))
    if CREATE in stages:
        work = _through(work, stages[CREATE], subjects, request, crew, settled)
        names = tuple(dict.fromkeys((*names, *work.session.infrastructure())))
    if BUILD in stages:
        asked, names = names, _with_followers(start.session, work, names) if request.follow else names
        build = partial(stages[BUILD], followers=frozenset(names).difference(asked))
        work = _through(work, build, names, request, crew, settled)
    unsigned = work.session
    if INSTALL in stages:
        stage = stages[INSTALL](unsigned, settled=settled)
        planned = _planned(stage, names, crew, settled)
        work = _checked(work.then(stage.plan(planned), INSTALL), INSTALL, request)
        work = replace(work, rights=stage.rights)
        if superseding := _superseding(changed.session, work.of(INSTALL), request):
            crew.close()
            return _conducted(start, superseding, crew)
        issued = [each.name for each in planned if not each.withdrawn and each.name not in settled]
        del planned  # what the register has of each package takes memory
        if request.follow:
            work = work.then(plan_distribution(start.session, work.session, names), INSTALL)
    work = work.noting(*request.notes(work))
    if not _proves(request) or (request.follow and not issued):  # a revocation does not wait for a proof of others
        return work
    return _proved(work, unsigned, [name for name in names if name not in settled], issued, request, crew)


def _new_packages(session: Session, names: Sequence[str], stages: _Stages, request: Request) -> NewPackages | None:
    """Return the packages that are new, as far as a run goes through all stages as usual; None if there are none."""
    is_usual = not (request.valid_for or request.adopts or request.beside or request.options.allow_vendor_specific)
    if request.policy is None or not is_usual or tuple(stages) != (CREATE, BUILD, INSTALL, PROVE):
        return None
    if not set(names).difference(session.packages()):
        return None
    return NewPackages.of(session, request.policy, tuple(stages))


def _settled(work: Work, names: Sequence[str], create: CreateStage) -> frozenset[str]:
    """Return the packages that no stage need look at: they are as the same command left them, and told nothing then.

    Their folders and rules are the same, and so is what all packages share: the profile, the authorities, the register.
    Packages whose documents depend on others are never among them.

    Args:
        work: what comes before the stages.
        names: the packages.
        create: the stage that creates them.
    """
    session, workspace = work.session, work.session.workspace
    changed, state = session.tree.changed, session.state
    if changed is None or work.plan.writes() or any(map(shared_type, state.stamps.get(BUILD, ()))):
        return frozenset()
    if session.infrastructure():
        return frozenset()
    own = (workspace.src, workspace.build, session.enclaves, workspace.identities)
    touched = {ROOT}
    for folder in changed:
        space = next((f"{each}/" for each in own if f"{folder}/".startswith(f"{each}/")), "")
        if not space and not f"{folder}/".startswith((f"{workspace.profile}/", f"{workspace.install}/")):
            return frozenset()
        name = folder.removeprefix(space) if space else ""
        while name:
            touched.add(name)
            name = name.rpartition("/")[0]
    return frozenset(name for name in names if name not in touched and create.follows(name))


def _planned(stage: PackageStage, names: Sequence[str], crew: Crew, settled: frozenset[str]) -> list[PackagePlan]:
    """Return what a stage plans for each package; nothing changes for those that are settled."""
    planned = crew.planned(stage, [name for name in names if name not in settled])
    if not settled:
        return planned
    looked = {each.name: each for each in planned}
    kept = {name: PackagePlan(name, Step(stage.NAME, name, Action.UNCHANGED)) for name in settled.intersection(names)}
    return [found for name in names if (found := kept.get(name) or looked.get(name))]


def _proved(
    work: Work, unsigned: Session, names: Sequence[str], issued: Sequence[str], request: Request, crew: Crew
) -> Work:
    """Return the work with the proof of all that it signs.

    Args:
        work: what will be done.
        unsigned: the workspace before the installation.
        names: the packages to install.
        issued: those of them that are not withdrawn.
        request: what is asked for.
        crew: who plans packages.

    Raises:
        KeymintError: a claim about an enclave is refuted or unknown; exit code 3.
    """
    options = request.options
    if BUILD in request.stages and not options.build:
        of_vendors = any(options_as_built(unsigned, name).allow_vendor_specific for name in issued)
        options = replace(options, allow_vendor_specific=options.allow_vendor_specific or of_vendors)
    policy, warnings = (request.policy, ()) if request.policy else policy_in_force(unsigned)
    # New shared documents decide about enclaves that stay as they are, too.
    concerned = {*names, *affected_packages(unsigned, work.session)}
    return proven(crew, work.noting(*warnings), concerned, policy, options)


def _proves(request: Request) -> bool:
    return INSTALL in request.stages and request.options.prove


def _with_authorities(work: Work, request: Request) -> tuple[Work, Authorities]:
    """Return the work with the authorities and their revocation lists, and the authorities by name."""
    minted, authorities = plan_authorities(work.session, request.options.new_authority)
    work = work.then(minted, AUTHORITIES)
    if request.adopts:
        return work, authorities
    register = complete_register(work.session) if request.follow else None
    listed = plan_lists(
        work.session, authorities, register=register, refresh=request.refresh, end=request.list_end
    )  # fmt: skip
    return work.then(listed, LISTS), authorities


def _stages(request: Request, authorities: Authorities, crew: Crew) -> _Stages:
    """Return what makes each stage of a request for a workspace; that of the proof if its policy is known already."""
    options, policy = request.options, request.policy
    stages: dict[str, Callable[..., Any]] = {}
    if CREATE in request.stages:
        acquired = cast("LoadedPolicy", policy)
        stages[CREATE] = partial(CreateStage, policy=acquired, force=options.force, valid_for=request.valid_for)
    if BUILD in request.stages:
        stages[BUILD] = partial(BuildStage, asked=options, policy=policy)
    if INSTALL in request.stages:
        stages[INSTALL] = partial(InstallStage, authorities=authorities, prune=options.prune)
    if policy and _proves(request):
        stages[PROVE] = proof_stage(crew, policy, options)
    return stages


def _through(
    work: Work,
    make: Callable[[Session], Any],
    names: Sequence[str],
    request: Request,
    crew: Crew,
    settled: frozenset[str] = frozenset(),
) -> Work:
    """Return the work followed by a stage before the installation."""
    stage = make(work.session)
    plan = stage.plan(_planned(stage, names, crew, settled))
    return _checked(work.then(plan, stage.NAME, before=AUTHORITIES if request.late else ""), stage.NAME, request)


def _checked(work: Work, stage: str, request: Request) -> Work:
    if stage in request.checks:
        request.checks[stage](work)
    return work


def _with_followers(before: Session, work: Work, names: Sequence[str]) -> tuple[str, ...]:
    """Return packages that are issued again, and those that must follow them.

    Args:
        before: the workspace before the sources changed.
        work: the changed sources, and the revocation lists.
        names: the packages.
    """
    session = work.session
    if any(session.role(name) is Role.INFRASTRUCTURE for name in names):
        # All others name it, so they follow its generation; those whose own sources changed wait for their build.
        built_of = [
            name
            for name in session.packages()
            if is_build_current(before, name) and not is_build_current(session, name)
        ]
        names = (*names, *built_of)
    if work.of(LISTS).writes() and any(map(current_rollover, session.profile.authorities)):
        names = (*names, *with_sources(session))  # their authorities' file has the lists
    return tuple(dict.fromkeys(names))


def updated_packages(plan: Plan) -> list[str]:
    """Return the packages whose enclave a plan writes."""
    changing = {Action.UPDATED, Action.CREATED}
    steps = (step for step in plan.steps if step.stage == INSTALLED and step.action in changing)
    return [step.package for step in steps if step.package]


def _superseding(session: Session, installed: Plan, request: Request) -> Request | None:
    """Return the request that first revokes the certificates of packages whose new rights are narrower, or None.

    What is planned so far is then planned again after it: each package gets a certificate of a new generation.

    Args:
        session: the workspace before its authorities and the stages; its profile may ask for it.
        installed: the plan of an installation.
        request: the user may ask for it.

    Raises:
        KeymintError: the register is missing and cannot be restored.
    """
    asked = request.options.revoke_superseded or session.profile.revoke_superseded
    found = dict.fromkeys(name_of(each.subject) for each in installed.diagnostics if each.code == RIGHTS_OUTLIVE)
    if not asked or not found or request.beside:
        return None
    revoking = _plan_revocation(session, tuple(found), SUPERSEDED)
    if not revoking.plan.writes():
        return None
    change = revoking.plan.noting(*revoking.diagnostics)
    return replace(request, change=request.change.then(change) if request.change else change, follow=True)


def plan_distribution(before: Session, session: Session, omitted: Collection[str]) -> Plan:
    """Plan the revocation lists of all installed enclaves.

    Args:
        before: the workspace with the lists of the last installation.
        session: the workspace with the lists in force.
        omitted: enclaves that are left as they are.
    """
    in_force = enclave_lists(session)
    if not in_force:
        return Plan((), session.state)
    issuers = {name: certificates.load_bundle(chain)[0] for name, chain in trusted_chains(session).items() if chain}
    steps: list[Step] = []
    stamps: dict[str, Stamp] = {}
    for name in enclave_names(session):
        if name in omitted:
            continue
        folder = session.enclave(name)
        build_types = recorded_build_types(session, name)
        possible = {authority: _files(session, build_types, content) for authority, content in in_force.items()}
        if not any(possible.values()):  # it has no list, and is as current as before there was another one
            stamps |= _followed(before, session, name, {})
            continue
        if len(possible) == 1 and not any(_different(session, folder, files) for files in possible.values()):
            continue  # nobody else's list could be in force, so the certificate need not be read
        certificate = installed_certificate(session, name)
        files: dict[str, File] = {}
        for authority, of_list in possible.items():
            issuer = issuers.get(authority)
            if certificate and issuer and certificates.is_issued_by(certificate, issuer):
                files |= of_list
        different = _different(session, folder, files)
        if not different:
            continue
        for file, item in different.items():
            where = session.workspace.origin(folder / file)
            require_nothing_lost(session.tree.try_read(f"{folder}/{file}"), item.content, where)
        steps.append(Step(INSTALLED, name, Action.UPDATED, (FolderChange(folder, different),), "revocation list"))
        stamps |= _followed(before, session, name, files)
    return Plan(tuple(steps), session.state.updated(INSTALLED, stamps))


def _followed(before: Session, session: Session, name: str, files: Mapping[str, File]) -> Mapping[str, Stamp]:
    """Return the stamp of an enclave after its lists changed, by its name; none if it stays, or there is none."""
    stamp = session.state.stamp(INSTALLED, name)
    if stamp is None or (not files and stamp.inputs == install.inputs_of(session, name)):
        return {}
    outputs = {**stamp.outputs, **{file: item.digest for file, item in files.items()}}
    inputs = install.inputs_of(session, name) if install.is_current(before, name) else None
    return {name: replace(stamp, outputs=outputs, inputs=inputs or stamp.inputs)}


def _different(session: Session, folder: Path, files: Mapping[str, File]) -> dict[str, File]:
    """Return the files that a folder does not have with this content."""
    return {file: item for file, item in files.items() if session.tree.digest(f"{folder}/{file}") != item.digest}


@once
def _files(session: Session, build_types: tuple[str, ...], revocations: bytes) -> dict[str, File]:
    """Return the files of a list by name, as the transports read them."""
    found = (session.plugins.build_type(name, session.profile_marker()) for name in build_types)
    artifacts = revocation_files(found, session.profile.distro, session.profile.layout, revocations)
    return {file: File(artifact.content) for file, artifact in artifacts}
