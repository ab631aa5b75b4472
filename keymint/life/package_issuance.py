# SPDX-License-Identifier: Apache-2.0
"""What an authority decided about the certificate of each package: read from its sources, and planned into them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin
from keymint.api import Issuance
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.store.changes import Action, Plan, Step, folder_changes
from keymint.view.stamps import digest
from keymint.workspace.session import Session

_CREATE = "create"
"""Key of the record of the stage that made the packages."""


def place_of(session: Session, name: str) -> Origin:
    """Return the place of what the authority decided about a package, or of the package's manifest if it has none."""
    files = session.issuance_files
    if files is None:
        return session.package_marker(name)
    return session.workspace.origin(session.workspace.src / name / files.ISSUANCE)


def plan_issuance(session: Session, stage: str, new: Mapping[str, Issuance], detail: str = "") -> Plan:
    """Plan to write what the authority decided about some packages into their sources.

    Args:
        session: the workspace and its profile.
        stage: name of the stage in the steps, i.e. the verb.
        new: what the authority decided, by package.
        detail: a few words for the user, for each step.

    Raises:
        KeymintError: the type of the packages keeps no such decisions, a generation falls, or the certificate of a
            package would get a serial number twice.
    """
    files = session.issuance_files
    if files is None:
        raise KeymintError(
            f"packages of the type {session.profile.package_type!r} do not keep what an authority decides, so they can "
            "neither be renewed nor revoked",
            where=session.profile_marker(),
            help="change their sources by hand, then run 'keymint build' and 'keymint install'",
            code="issuance-unsupported",
        )
    if errors := [error for name, issuance in new.items() for error in _defects(session, name, issuance)]:
        raise KeymintError.of(errors)
    steps: list[Step] = []
    state, stamps = session.state, {}
    for name, issuance in new.items():
        written = files.with_issuance(issuance)
        changes = folder_changes(session.tree, session.workspace.src / name, written)
        steps.append(Step(stage, name, Action.UPDATED if changes else Action.UNCHANGED, changes, detail))
        # The stage that made the package must not take the file for an edit of its owner.
        if changes and (stamp := state.stamp(_CREATE, name)):
            outputs = {**stamp.outputs, **{file: digest(content) for file, content in written.items()}}
            stamps[name] = replace(stamp, outputs=outputs)
    return Plan(tuple(steps), state.updated(_CREATE, stamps) if stamps else state)


def _defects(session: Session, name: str, new: Issuance) -> list[Diagnostic]:
    """Return why the authority must not decide this about a package."""
    before = session.issuance(name)
    subject, where = subject_of(name), place_of(session, name)
    if new.generation < before.generation:
        message = f"has generation {before.generation}, and would fall to {new.generation}"
        return [Diagnostic.error("generation-falls", message, where, "never lower a generation", subject)]
    identity = session.package(name).identity
    if identity.serial is not None and (new.generation, new.renewed) != (before.generation, before.renewed):
        return [
            Diagnostic.error(
                "serial-fixed",
                f"the sources give the serial number {identity.serial}, so the certificate cannot be issued again",
                identity.origin,
                "leave <serial_number> out or empty, so that each certificate gets a number of its own",
                subject,
            )
        ]
    return []
