"""The options that shape a new workspace's profile."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import click

from comarmor.errors import Origin
from keymint.api import ProfileSettings
from keymint.commands.common import Run
from keymint.errors import KeymintError
from keymint.workspace import PROFILE_MARKER, Workspace

DEFAULT_PROFILE_TYPE = "keymint_ros"
_DEFAULTS = "package.defaults"
_PLACES = {
    "domain": (f"{_DEFAULTS}/permissions.xml", f"{_DEFAULTS}/governance.xml"),
    "subject-format": (f"{_DEFAULTS}/permissions.xml", f"{_DEFAULTS}/identities.xml"),
}
"""Where a setting is that is not in the profile's marker; all the places have to agree."""

PROFILE_OPTIONS: Sequence[Callable[[Any], Any]] = (
    click.option(
        "--profile-type",
        metavar="NAME",
        help=f"Plugin that makes the profile; 'keymint plugins' lists them [{DEFAULT_PROFILE_TYPE}].",
    ),
    click.option("--distro", metavar="NAME", help="ROS 2 distribution [$ROS_DISTRO, else jazzy]."),
    click.option("--domain", type=click.IntRange(0, 230), metavar="N", help="DDS domain id [0]."),
    click.option(
        "--layout",
        type=click.Choice(["sros2", "flat"]),
        help="Layout of the install space: sros2 for Foxy and later, flat for older ones [sros2, for ardent flat].",
    ),
    click.option(
        "--subject-format",
        type=click.Choice(["unique", "sros2"]),
        help="Subject names: CN and a second RDN that no other subject has, or the bare CN of SROS2 [unique].",
    ),
)


new_authority_option = click.option(
    "--new-authority",
    multiple=True,
    metavar="NAME",
    help="Replace the key and certificate of this authority by new ones, for good: no deployed enclave trusts what it "
    "signs from then on, until all are redeployed. May be given again.",
)


def add_options(options: Sequence[Callable[[Any], Any]]) -> Callable[[Any], Any]:
    """Return a decorator that adds options in this order."""

    def decorate(function: Any) -> Any:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


def refuse_contradiction(run: Run, workspace: Workspace, asked: Mapping[str, object]) -> None:
    """Refuse an option that differs from the profile of an existing workspace.

    Args:
        run: the verb under way.
        workspace: the existing workspace.
        asked: values by option name; None for an option that was not given.

    Raises:
        KeymintError: the profile has another value, or it does not have this setting.
    """
    given = {option: str(value) for option, value in asked.items() if value is not None}
    if not given:
        return
    profile = run.inputs(workspace).profile().profile
    profile_type = run.plugins.profile_type(profile.profile_type)
    present = {"profile-type": profile.profile_type}
    if isinstance(profile_type, ProfileSettings):
        present |= profile_type.settings(profile)
    for option, value in given.items():
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
