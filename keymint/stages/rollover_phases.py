# SPDX-License-Identifier: Apache-2.0
"""The plans of ``keymint authority replace``: each phase, and what must be complete before it.

Where a transport cannot trust two authorities at once, the next one gets a second keystore beside the one in force, and
the two are exchanged. It is planned as the keystore in force will be once the next authority is, with the profile, keys
and documents of that time. Only its files are written, and nothing that the workspace records.
"""

from __future__ import annotations

import stat
from collections.abc import Sequence
from pathlib import Path

from comarmor.text import quantity
from comarmor.values import Data, replace
from keymint.api import Phase
from keymint.authority import rollover
from keymint.authority.authorities import Authorities, authority_named, plan_authorities
from keymint.authority.authority_changes import GivenAuthority, refusing_implementations
from keymint.authority.authority_files import FORMER, NEXT
from keymint.errors import Diagnostic, KeymintError, Origin, usage_error
from keymint.life.revocation_lists_in_force import plan_lists
from keymint.names import subject_of
from keymint.pki import certificates
from keymint.stages import install
from keymint.stages.pipeline import INSTALL, PROVE, Request, conduct
from keymint.stages.work import Crew, InstallRequest, Work
from keymint.store.changes import Action, File, FolderChange, Plan, Step, folder_changes
from keymint.workspace.installed_enclaves import with_sources
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session
from keymint.workspace.workspace import GITIGNORE

STAGE = "install.next"
DEFERRED = "second-keystore-deferred"


def staged_keystore(crew: Crew, session: Session, name: str, names: Sequence[str]) -> Plan:
    """Plan the second keystore; what is right of it stays.

    Args:
        crew: who plans packages.
        session: the workspace in the phase ``stage`` of an authority's replacement, and its profile.
        name: the authority.
        names: the packages whose enclaves it has.

    Raises:
        KeymintError: an enclave cannot be built, signed or proven; with all defects.
    """
    ahead = rollover.staged_session(session, name)
    names = tuple(dict.fromkeys((*names, *with_sources(ahead))))  # what was revoked since is withdrawn from it as well
    asked = InstallRequest(prune=True)
    request = Request(names, options=asked, policy=lazy_policy(ahead), follow=False, beside=True)
    work = conduct(Work(ahead), request, crew)
    done = work.of(INSTALL, PROVE)
    steps = [replace(step, stage=STAGE) for step in done.steps]
    own, beside = _lists(session, name)
    content = work.session.tree.read(own)
    if content is not None and content != session.tree.read(beside):
        change = FolderChange(beside.parent, {beside.name: File(content)})
        steps.append(Step(STAGE, name, Action.UPDATED, (change,), "revocation list"))
    return replace(done, steps=tuple(steps), state=session.state, first=work.plan.first)


def in_step(crew: Crew, session: Session, plan: Plan) -> Plan:
    """Return a plan that changes enclaves, followed by the same change of the second keystore, if one is staged.

    Args:
        crew: who plans packages.
        session: the workspace before the plan, and its profile.
        plan: the plan; if the second keystore cannot follow, it has a warning of the code :data:`DEFERRED`.
    """
    staged = [each.name for each in session.profile.authorities if rollover.phase_of(session, each.name) is Phase.STAGE]
    for name in staged if plan.writes() else ():
        work = Work(session).then(plan)
        try:
            plan = work.then(staged_keystore(crew, work.session, name, with_sources(work.session))).plan
        except KeymintError as error:
            found = error.diagnostics[0]
            message = f"the second keystore is deferred: {found.message}"
            help_ = f"'keymint authority replace {name}' brings it up to date; copy it to all robots again"
            plan = plan.noting(Diagnostic.warning(DEFERRED, message, found.where, help_))
    return plan


def session_ahead(session: Session, name: str) -> tuple[Session, Authorities]:
    """Return the session and the authorities as they will be, with the second keystore as the one in force.

    Args:
        session: the workspace in the phase ``stage`` of an authority's replacement, and its profile.
        name: the authority.

    Raises:
        KeymintError: an authority cannot be used; as :func:`keymint.authority.authorities.plan_authorities`.
    """
    work = Work(rollover.staged_session(session, name))
    minted, authorities = plan_authorities(work.session)
    work = work.then(minted)
    return work.then(plan_lists(work.session, authorities)).session, authorities


def _lists(session: Session, name: str) -> tuple[Path, Path]:
    """Return the paths of the revocation lists of an authority: the one in force, and that of the next authority."""
    workspace = session.workspace
    return workspace.revocation_list(name), workspace.revocation_list(f"{name}.{NEXT}")


def exchanged_keystore(crew: Crew, session: Session, name: str, names: Sequence[str]) -> Plan:
    """Plan that the second keystore becomes the one in force, and that the next authority is the only one.

    Args:
        crew: who plans packages.
        session: the workspace in the phase ``stage``, with a complete second keystore.
        name: the authority.
        names: the packages whose enclaves it has.

    Raises:
        KeymintError: an enclave cannot be built, signed or proven; with all defects.
    """
    switch = rollover.plan_switch(session, name)
    key, *profile = switch.steps
    own, beside = _lists(session, name)
    content = session.tree.read(beside)
    list_in_force = () if content is None else folder_changes(session.tree, own.parent, {own.name: content})
    copies = Step("install", "", Action.UPDATED, (*_copied(session), *list_in_force), "the second keystore")
    first = replace(switch, steps=(key, copies, *profile))
    done = conduct(Work(session).then(first), Request(names), crew).plan
    # The profile comes late: until then a run that was killed is recognised by the key, and copies the rest.
    others = done.steps[len(first.steps) :]
    return replace(done, steps=(key, copies, *others, *profile, *dropped_keystore(session)))


def dropped_keystore(session: Session) -> tuple[Step, ...]:
    """Return the step that removes the second keystore; none if there is none."""
    folders: dict[Path, list[str]] = {}
    for path, is_folder in session.tree.walk(session.workspace.next_install):
        if not is_folder:
            folders.setdefault(Path(path).parent, []).append(Path(path).name)
    changes = tuple(FolderChange(folder, removed=tuple(sorted(names))) for folder, names in sorted(folders.items()))
    return (Step(STAGE, "", Action.REMOVED, changes, "the second keystore"),) if changes else ()


def _copied(session: Session) -> list[FolderChange]:
    """Return the files of the second keystore as changes of the one in force, each with its mode."""
    workspace, tree = session.workspace, session.tree
    folders: dict[Path, dict[str, File]] = {}
    for path, is_folder in tree.walk(workspace.next_install):
        content, status = (None, None) if is_folder else (tree.read(path), tree.status(path))
        if content is None or status is None or Path(path).name == GITIGNORE:
            continue
        target = workspace.install / Path(path).relative_to(workspace.next_install)
        if tree.try_read(target) != content:
            secret = not stat.S_IMODE(status.st_mode) & 0o077
            folders.setdefault(target.parent, {})[target.name] = File(content, secret=secret)
    return [FolderChange(folder, files) for folder, files in sorted(folders.items())]


_NEXT = {Phase.DISTRIBUTE: Phase.REISSUE, Phase.REISSUE: Phase.END, Phase.STAGE: Phase.END}
"""The phase that follows each."""


class PhaseRequest(Data):
    """What the user asks for.

    Attributes:
        phase: the phase to reach; None to begin, or to complete the one that was reached.
        cancel: give up.
        vendors: names of the implementations that the fleet has; empty for all.
        given: the next authority, if it was made elsewhere.
    """

    phase: Phase | None = None
    cancel: bool = False
    vendors: tuple[str, ...] = ()
    given: GivenAuthority | None = None


def phase_plan(crew: Crew, session: Session, name: str, request: PhaseRequest) -> Plan:
    """Return the plan of a phase; of one that was reached already, what is missing.

    Raises:
        KeymintError: the request does not fit to the phase that was reached, the phase before is not complete, or an
            enclave cannot be built, signed or proven; with all defects.
    """
    phase, names = rollover.phase_of(session, name), _names(session, name)
    if request.cancel or (phase is None and request.phase is Phase.END):
        # Without a phase there may be something missing of an end that a killed run began.
        begun = phase is not None
        left = Plan(rollover.without_keys(session, name, NEXT, FORMER), session.state)
        first = rollover.plan_cancel(session, name) if begun else left
        first = replace(first, steps=(*first.steps, *dropped_keystore(session)))
        return conduct(Work(session).then(first), Request(names), crew).plan
    if phase is None:
        return _begun(crew, session, name, names, request)
    _require_same_begin(session, name, phase, request)
    following = _NEXT[phase]
    if rollover.is_interrupted(session, name) and request.phase in {None, following}:
        return _went_on(crew, session, name, names)
    if request.phase in {None, phase}:
        return _completed(crew, Work(session), name, names, phase)
    if request.phase is not following:
        message = f"the key of the authority {name!r} is in the phase {phase}: {request.phase} does not follow it"
        raise usage_error(message, f"'keymint authority replace {name} --phase {following}' does")
    if phase is Phase.STAGE:
        require_staged(crew, session, name)
    else:
        completed = f"'keymint authority replace {name}' completes it; then copy the keystore to all robots"
        _require_current(session, names, f"the keystore of the phase {phase}", completed)
    return _went_on(crew, session, name, names)


def _names(session: Session, name: str) -> Sequence[str]:
    """Return the packages whose enclaves follow.

    Raises:
        KeymintError: nothing is installed.
    """
    authority_named(session, name)
    names = with_sources(session)
    if not names:
        message = "nothing is installed, so nobody trusts an authority yet"
        help_ = f"'keymint install --new-authority {name}' makes a new one at once"
        raise KeymintError(message, help=help_, code="enclave-missing")
    return names


def _require_same_begin(session: Session, name: str, phase: Phase, request: PhaseRequest) -> None:
    """Require that a request which begins is the one that began: it may be given again after it was killed.

    Raises:
        KeymintError: it names another way or another authority.
    """
    issuance = authority_named(session, name).issuance
    way = Phase.STAGE if refusing_implementations(session, name, request.vendors, "bundles") else Phase.DISTRIBUTE
    same = phase is way if request.vendors else True
    if request.given and issuance.rollover:
        same = same and certificates.load(request.given.certificate) == certificates.load(issuance.rollover.certificate)
    if not same:
        message = f"the key of the authority {name!r} is being replaced already (phase {phase})"
        raise usage_error(message, "leave --vendor, --certificate and --key out; or --cancel it first")


def _begun(crew: Crew, session: Session, name: str, names: Sequence[str], request: PhaseRequest) -> Plan:
    refused = refusing_implementations(session, name, request.vendors, "bundles")
    phase = request.phase or (Phase.STAGE if refused else Phase.DISTRIBUTE)
    if phase is Phase.REISSUE:
        message = f"the key of the authority {name!r} is not being replaced"
        raise KeymintError(message, help=f"'keymint authority replace {name}' begins", code="rollover-none")
    if phase is Phase.DISTRIBUTE and refused:
        message = f"{' and '.join(refused)} cannot trust two authorities {name!r} at once"
        help_ = "stage a second keystore: leave --phase out; or name what the fleet has with --vendor"
        raise KeymintError(message, help=help_, code="rollover-no-bundle")
    _require_current(session, names, "the present keystore", "'keymint build' and 'keymint install' complete it")
    work = Work(session).then(rollover.plan_begin(session, name, phase, request.given))
    return _completed(crew, work, name, names, phase)


def _completed(crew: Crew, work: Work, name: str, names: Sequence[str], phase: Phase) -> Plan:
    """Return what is missing of a phase."""
    work = conduct(work, Request(names), crew)
    return work.then(staged_keystore(crew, work.session, name, names)).plan if phase is Phase.STAGE else work.plan


def _went_on(crew: Crew, session: Session, name: str, names: Sequence[str]) -> Plan:
    """Return the plan of the next phase; of one that a killed run began, what is missing."""
    phase = rollover.phase_of(session, name)
    if phase is Phase.STAGE:
        return exchanged_keystore(crew, session, name, names)
    first = rollover.plan_switch(session, name) if phase is Phase.DISTRIBUTE else rollover.plan_end(session, name)
    return conduct(Work(session).then(first), Request(names), crew).plan


def _require_current(session: Session, names: Sequence[str], what: str, help_: str) -> None:
    """Require that all enclaves are as the sources and the authorities say.

    Raises:
        KeymintError: one is not, so a phase would begin before the one before it is complete.
    """
    stale = [each for each in names if not install.is_current(session, each)]
    if stale:
        raise KeymintError(
            f"{what} is not complete: {quantity(len(stale), 'enclave')} not up to date, e.g. {subject_of(stale[0])}",
            where=session.workspace.origin(session.enclave_folder(stale[0])),
            help=help_,
            code="rollover-incomplete",
        )


def require_staged(crew: Crew, session: Session, name: str) -> None:
    """Require that the second keystore of an authority's replacement is complete and as the sources say.

    Raises:
        KeymintError: it is not.
    """
    if staged_keystore(crew, session, name, _names(session, name)).writes():
        shown = session.workspace.shown(session.workspace.next_install)
        message = "the second keystore is not as the sources and the authorities say now"
        help_ = f"'keymint authority replace {name}' brings it up to date; copy it to all robots again"
        raise KeymintError(message, where=Origin(shown), help=help_, code="rollover-incomplete")
