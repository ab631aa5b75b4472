# SPDX-License-Identifier: Apache-2.0
"""Plan what mends a keystore that another tool made: each step alone, since each has its cost."""

from __future__ import annotations

from collections.abc import Sequence

from keymint.api import Validity
from keymint.authority.authorities import authority_named
from keymint.errors import KeymintError
from keymint.store.changes import Action, Plan, Step, folder_changes
from keymint.workspace.session import Session

STAGE = "harden"


def plan_names(session: Session, names: Sequence[str]) -> Plan:
    """Plan a unique RDN in the subject names of some packages; their sources change only.

    Raises:
        KeymintError: the sources are written in another way than Keymint writes them.
    """
    steps = []
    for name in names:
        new = session.package_type.with_unique_name(session.profile, name, session.package_files(name))
        if new is None:
            raise _unsupported(session, f"packages of the type {session.profile.package_type!r}")
        changes = folder_changes(session.tree, session.workspace.src / name, new)
        steps.append(Step(STAGE, name, Action.UPDATED if changes else Action.UNCHANGED, changes, "unique subject name"))
    return Plan(tuple(steps), session.state)


def plan_authority(session: Session, former: str) -> Plan:
    """Plan another authority for the signature of documents, which outlives them; the profile changes only.

    Raises:
        KeymintError: the profile is written in another way than Keymint writes it, or has such an authority.
    """
    profile = session.profile
    name = session.profile_type.SIGNER
    if not name:
        raise _unsupported(session, f"profiles of the type {profile.profile_type!r}")
    if name in {each.name for each in profile.authorities}:
        raise KeymintError(
            f"the profile has an authority {name!r} already", where=session.profile_marker(),
            help="rename that authority, or name it as the signer in package.defaults/", code="authority-exists",
        )  # fmt: skip

    def plan(validity: Validity | None) -> Plan:
        edited = session.profile_type.with_own_signer(profile, former, validity)
        changes = folder_changes(session.tree, session.workspace.profile, edited)
        return Plan((Step(STAGE, "", Action.UPDATED, changes, f"{name} signs in place of {former}"),), session.state)

    of_defaults = authority_named(session.after(plan(None)).session(), name).certificate.validity
    grants = [session.package(each).grant for each in session.packages()]
    ends = [each.validity.not_after for each in grants if each.validity and each.issuer == former]
    end = max(ends, default=of_defaults.not_after)
    return plan(Validity(of_defaults.not_before, end) if end > of_defaults.not_after else None)


def _unsupported(session: Session, what: str) -> KeymintError:
    return KeymintError(
        f"{what} cannot be changed by Keymint", where=session.profile_marker(), help="change them by hand",
        code="harden-unsupported",
    )  # fmt: skip
