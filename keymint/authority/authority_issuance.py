# SPDX-License-Identifier: Apache-2.0
"""What was decided about the certificates of authorities: written into the profile space."""

from __future__ import annotations

from keymint.api import Authority, AuthorityIssuance, AuthorityIssuanceFiles
from keymint.errors import ExitCode, KeymintError, known_authority
from keymint.store.changes import Action, Plan, Step, changed_below
from keymint.workspace.session import Session

STAGE = "authorities"


def authority_named(session: Session, name: str) -> Authority:
    """Return an authority of the profile.

    Raises:
        KeymintError: there is none of this name; exit code 2.
    """
    known = {authority.name: authority for authority in session.profile.authorities}
    return known[known_authority(name, known, None, exit_code=ExitCode.USAGE)]


def plan_authority_issuance(session: Session, name: str, new: AuthorityIssuance, detail: str) -> Plan:
    """Plan what was decided about an authority; of the others it stays.

    Args:
        session: the workspace and its profile.
        name: the authority.
        new: what was decided.
        detail: a few words for the user.

    Raises:
        KeymintError: the type of the profile cannot keep it.
    """
    profile = session.profile
    plugin = session.profile_type
    if not isinstance(plugin, AuthorityIssuanceFiles):
        raise KeymintError(
            f"the profile type {profile.profile_type!r} cannot keep what is decided about authorities",
            where=session.profile_marker(),
            help="change the dates in the profile instead, and run 'keymint install'",
            code="profile-without-issuance",
        )
    issuance = {**{each.name: each.issuance for each in profile.authorities}, name: new}
    changes = changed_below(session.tree, session.workspace.profile, plugin.with_authority_issuance(issuance))
    if not changes:
        return Plan((), session.state)
    return Plan((Step(STAGE, "", Action.UPDATED, changes, detail),), session.state)
