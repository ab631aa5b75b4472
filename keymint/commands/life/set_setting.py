# SPDX-License-Identifier: Apache-2.0
"""``keymint set``: settings of the workspace that ``init`` gave it, e.g. its domain."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.text import did_you_mean, quantity
from keymint.command_line.agreement import FEWEST
from keymint.command_line.options import iso_validity
from keymint.command_line.verb import Report, Run, argument, verb
from keymint.errors import KeymintError, usage_error
from keymint.names import subject_list, subject_of
from keymint.stages.create import library_changes
from keymint.store.changes import Action, Plan, Step, folder_changes
from keymint.workspace.installed_enclaves import with_sources
from keymint.workspace.session import Session
from keymint.workspace.workspace import PROFILE_MARKER

STAGE = "set"


@verb(dry_run=True, name="set")
def set_setting(
    run: Run, setting: str | None = argument(required=False), value: str | None = argument(required=False)
) -> Report:
    """Change a setting of the workspace in its profile, whose comments and layout stay.

    \b
    SETTING is one of
      domain, distro, subject-format, valid-for
    with a VALUE as 'keymint init --help' says. Without VALUE, the settings are shown.

    Signs nothing, and lists what the next 'build' and 'install', or 'provision', will sign again.
    """
    session = run.session()
    known = session.profile_type.SETTINGS
    if setting is not None and setting not in known:
        hint = did_you_mean(setting, known, f"settings are {', '.join(known)}; 'keymint init' decides about others")
        raise usage_error(f"there is no setting {setting!r} that 'set' changes", hint, "setting-unknown")
    if value is None or setting is None:
        present = session.profile_type.settings(session.profile)
        rows = [{"setting": each, "value": present.get(each)} for each in known if setting in {None, each}]
        run.console.table({"SETTING": "setting", "VALUE": "value"}, rows)
        return run.report({"settings": rows, "signed_again": None}, workspace=session.workspace)
    wanted = iso_validity(value) if setting == "valid-for" else value

    def make_plan(session: Session) -> Plan:
        change = _change(session, setting, wanted)
        subjects = [*map(subject_of, _signed_again(session, change))]
        run.outcome = {"settings": [{"setting": setting, "value": wanted}], "signed_again": subjects}
        asks = setting in {"domain", "distro"} and len(subjects) >= FEWEST
        agreed = "; --yes agrees that rights of the former one end" if asks else ""
        run.lines = () if not subjects else (
            f"to be built and signed again: {quantity(len(subjects), 'enclave')}: {subject_list(subjects)}",
            f"run {_commands(session, ' --yes' if asks else '')}, then deploy and restart{agreed}",
        )  # fmt: skip
        return change

    return run.change(make_plan)


def _commands(session: Session, agreed: str) -> str:
    """Return the commands that sign again what a setting changes; the policy's file if the workspace has one policy."""
    if len(policies := session.profile.policies) == 1:
        policy, root = map(session.workspace.shown, (policies[0].path, session.workspace.root))
        return f"'keymint provision {policy} -w {root}{agreed}'"
    return f"'keymint create --all{agreed}', 'keymint build' and 'keymint install{agreed}'"


def _change(session: Session, setting: str, value: str) -> Plan:
    """Plan the edit of the profile.

    Raises:
        KeymintError: there is no such value, or the profile is written in a way that is not edited.
    """
    profile_type, profile, root = session.profile_type, session.profile, session.workspace.profile
    former = profile_type.settings(profile).get(setting)
    if former == value:
        return Plan((Step(STAGE, "", Action.UNCHANGED, (), f"{setting} is {value}"),), session.state)
    changes = folder_changes(session.tree, root, profile_type.with_setting(profile, setting, value, session.now))
    changes += library_changes(session, value) if setting == "distro" else ()
    plan = Plan((Step(STAGE, "", Action.UPDATED, changes, f"{setting} {value}, was {former}"),), session.state)
    if profile_type.settings(session.after(plan).session().profile).get(setting) != value:
        where = session.workspace.origin(root / next(iter(profile_type.PLACES.get(setting, ())), PROFILE_MARKER))
        message = f"has its {setting}, {former}, in a way that Keymint does not edit"
        raise KeymintError(message, where=where, help=f"write {value} by hand", code="setting-by-hand")
    return plan


def _signed_again(session: Session, change: Plan) -> Sequence[str]:
    """Return the installed packages that are others after a change of the profile."""
    after, names = session.after(change).session(), with_sources(session)
    own, library = (session.profile.distro, after.profile.distro), session.profile_type.library
    if own[0] != own[1]:  # distributions that have one library have the same documents
        return names if library(own[0]) != library(own[1]) else ()
    return [name for name in names if change.writes() and session.package(name) != after.package(name)]
