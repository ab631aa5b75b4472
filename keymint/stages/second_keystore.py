# SPDX-License-Identifier: Apache-2.0
"""A second keystore beside the one in force, by the next authority; and the exchange of the two.

It is planned as the keystore in force will be once the next authority is, with the profile, keys and documents of
that time. Only its files are written, and nothing that the workspace records.
"""

from __future__ import annotations

import stat
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from comarmor.errors import Diagnostic
from keymint.api import Phase
from keymint.authority.authorities import MintedAuthority, plan_authorities
from keymint.authority.authority_files import NEXT
from keymint.authority.rollover import phase_of, plan_switch, staged_session
from keymint.errors import KeymintError
from keymint.life.revocation_lists_in_force import plan_lists
from keymint.stages.install_request import InstallRequest
from keymint.stages.package_stage import Crew
from keymint.stages.pipeline import INSTALL, PROVE, Request, conduct
from keymint.stages.work import Work
from keymint.store.changes import Action, File, FolderChange, Plan, Step, folder_changes
from keymint.workspace.gitignore import NAME as GITIGNORE
from keymint.workspace.installed_enclaves import with_sources
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session

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
    ahead = staged_session(session, name)
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
    staged = [each.name for each in session.profile.authorities if phase_of(session, each.name) is Phase.STAGE]
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


def session_ahead(session: Session, name: str) -> tuple[Session, Mapping[str, MintedAuthority]]:
    """Return the session and the authorities as they will be, with the second keystore as the one in force.

    Args:
        session: the workspace in the phase ``stage`` of an authority's replacement, and its profile.
        name: the authority.

    Raises:
        KeymintError: an authority cannot be used; as :func:`keymint.authority.authorities.plan_authorities`.
    """
    work = Work(staged_session(session, name))
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
    switch = plan_switch(session, name)
    key, *profile = switch.steps
    copied = (*_copied(session), *_moved_list(session, name))
    copies = Step("install", "", Action.UPDATED, copied, "the second keystore")
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


def _moved_list(session: Session, name: str) -> tuple[FolderChange, ...]:
    """Return what puts the revocation list of the next authority in force, if it has one."""
    own, beside = _lists(session, name)
    content = session.tree.read(beside)
    return () if content is None else folder_changes(session.tree, own.parent, {own.name: content})


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
