"""Compare the options of a new workspace with an existing profile."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from comarmor.errors import Origin
from keymint.api import ProfileSettings
from keymint.commands.options import ProfileOptions
from keymint.commands.run import Run
from keymint.errors import KeymintError
from keymint.workspace import PROFILE_MARKER, Workspace

_DEFAULTS = "package.defaults"
_PLACES = {
    "domain": (f"{_DEFAULTS}/permissions.xml", f"{_DEFAULTS}/governance.xml"),
    "subject-format": (f"{_DEFAULTS}/permissions.xml", f"{_DEFAULTS}/identities.xml"),
}
"""Files of the settings that are not in the profile's manifest; all of them must agree."""


def refuse_contradiction(run: Run, workspace: Workspace, given: ProfileOptions, policy: Path | None = None) -> None:
    """Refuse an option that differs from the profile of an existing workspace.

    Args:
        run: the run.
        workspace: the existing workspace.
        given: the options of this run.
        policy: the value of ``--policy``, which only ``init`` has.

    Raises:
        KeymintError: the profile has another value, or does not have this setting.
    """
    options = {**asdict(given), "policy": policy}
    values = {name.replace("_", "-"): str(value) for name, value in options.items() if value is not None}
    if not values:
        return
    profile = run.inputs(workspace).session().profile
    profile_type = run.plugins.profile_type(profile.profile_type)
    if given.distro is not None:
        profile_type.library(given.distro)  # an unknown distribution is a usage error, as for a new workspace
    present = {"profile-type": profile.profile_type}
    if isinstance(profile_type, ProfileSettings):
        present |= profile_type.settings(profile)
    for option, value in values.items():
        if present.get(option) != value:
            places = _PLACES.get(option, (PROFILE_MARKER,))
            has = f"has {option} {present[option]!r}" if option in present else f"exists and keeps its {option}"
            raise KeymintError(
                f"the workspace {has}, so --{option} {value} cannot take effect",
                where=Origin(workspace.shown(workspace.profile / places[0])),
                help=f"change it in {' and '.join(workspace.shown(workspace.profile / place) for place in places)}, "
                "or name another workspace",
                code="workspace-exists",
            )
