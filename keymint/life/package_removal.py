# SPDX-License-Identifier: Apache-2.0
"""Removes packages for good: their sources, documents, keys and enclaves, and ends their certificates."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from keymint.api import LoadedPolicy, Role
from keymint.errors import Diagnostic, Origin, require_none
from keymint.life.package_issuance import Revoking, plan_revocation
from keymint.life.workspace_register import complete_register, register_of
from keymint.names import subject_of
from keymint.store.changes import Action, FolderChange, Plan, Step
from keymint.workspace.installed_enclaves import EnclaveChanges, enclave_names, last_steps, removal_step
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import IDENTITY_KEYS

STAGE, REASON = "remove", "retired"


def removable_names(session: Session) -> frozenset[str]:
    """Return the names of which there is anything to remove: a package, an enclave, or a key that was made."""
    return frozenset((*session.packages(), *enclave_names(session), *session.state.stamps.get(IDENTITY_KEYS, ())))


def certified_names(session: Session) -> frozenset[str]:
    """Return the names that ever had a certificate, as far as the register is here."""
    return frozenset(each.name for each in register_of(session).certificates.values() if each.name)


def require_unneeded(session: Session, names: Sequence[str]) -> None:
    """Require that nobody would make some packages again.

    Raises:
        KeymintError: the policy names one exactly, or the transport of the workspace needs it; with all of these.
    """
    policy = lazy_policy(session) if session.profile.policies else None
    named = frozenset(policy.subjects()) if policy else frozenset[str]()
    errors = [_named(policy, subject_of(name)) for name in names if policy and subject_of(name) in named]
    for name, (title, _) in session.needed_infrastructure().items():
        if name in names and session.role(name) is Role.INFRASTRUCTURE:
            message = f"{subject_of(name)} is {title} of this workspace"
            help_ = f"'keymint renew --rekey {name}' gives it a new key"
            errors.append(Diagnostic.error("package-needed", message, session.package_marker(name), help_))
    require_none(errors)


def _named(policy: LoadedPolicy, subject: str) -> Diagnostic:
    """Return the error that the policy names a subject which is to be removed."""
    structure = policy.structure()
    profiles = structure.profiles if structure else ()
    written: list[Origin] = [place for each in profiles for text, place in each.attachments if text == subject]
    where = next(iter(written), None) or next((each.where for each in policy.profiles(subject)), None)
    help_ = f"remove it from the policy first; to end its certificate only: 'keymint revoke {subject} --reason retired'"
    return Diagnostic.error("still-named", f"the policy names {subject}, so it would come back", where, help_, subject)


def plan_removal(session: Session, names: Sequence[str], *, deployed: bool) -> Revoking:
    """Plan the removal of all that a workspace has of some packages.

    Args:
        session: the workspace and its profile.
        names: the packages; their sources, or any other part, may be gone already.
        deployed: their certificates are revoked, since a robot may have them.

    Raises:
        KeymintError: the register is missing and cannot be restored.
    """
    installed = [name for name in enclave_names(session) if name in frozenset(names)]
    state = session.state
    for stage in session.state.stamps:
        state = state.updated(stage, {}, names)
    gone = Plan(tuple(_step(session, name) for name in names), state)
    after = session.after(gone)
    register = complete_register(session, installed) if deployed else None
    certified = [name for name in names if register and any(not each.revoked for each in register.of(name))]
    revoking = plan_revocation(after, certified, REASON)
    changes = EnclaveChanges(removed=frozenset(names))
    rest = tuple(removal_step(session, name, changes) for name in installed if name not in certified)
    rest += tuple(last_steps(session, changes))
    plan = gone.then(revoking.plan)
    return Revoking(plan.then(Plan(rest, plan.state)), revoking.certificates, (), (), revoking.diagnostics)


def _step(session: Session, name: str) -> Step:
    """Return the step that removes the files of a package that only the authority's machine has."""
    workspace = session.workspace
    folders = (f"{workspace.src}/{name}", f"{workspace.build}/{name}", f"{workspace.identities}/{name}")
    others = removable_names(session) - {name}
    changes = tuple(change for folder in folders for change in _below(session, folder, name, others))
    if changes:
        return Step(STAGE, name, Action.REMOVED, changes, "sources, documents and key")
    return Step(STAGE, name, Action.UNCHANGED, detail="nothing of it is left in the workspace")


def _below(session: Session, folder: str, name: str, others: Collection[str]) -> Iterator[FolderChange]:
    """Yield what removes all that is in a folder, but what belongs to other packages, whose names begin like it.

    The marker of a package goes last: what a stopped run leaves is a package.
    """
    entries = session.tree.names(folder)
    for entry, is_folder in entries:
        inner = f"{name}/{entry}"
        if is_folder and not any(f"{each}/".startswith(f"{inner}/") for each in others):
            yield from _below(session, f"{folder}/{entry}", inner, others)
    marker = session.package_type.MARKER
    if files := sorted((entry for entry, is_folder in entries if not is_folder), key=lambda each: each == marker):
        yield FolderChange(Path(folder), removed=tuple(files))
