# SPDX-License-Identifier: Apache-2.0
"""Note what the rules of subjects keep from starting: ``lint``, ``import``, ``adopt`` and ``check`` ask this."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

from comarmor.text import first_few
from comarmor.values import replace
from keymint.api import FoundEnclave, KeystoreFiles, KeystoreReader, LoadedPolicy
from keymint.api.plugin_loader import Plugins
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.ir import SubjectRules
from keymint.names import subject_of
from keymint.stages.prove import STAGE, policy_digest
from keymint.view.stamps import Stamp, State, digest
from keymint.workspace.package_build_types import SHARED, recorded_build_types
from keymint.workspace.session import Session

NODE_NOTES = frozenset({"node-cannot-start", "parameter-client-cannot-start"})
"""Codes of these notes, which are shown in any case."""
Subject = tuple[SubjectRules, Origin | None]
"""The rules of a subject, and the place that tells where they come from."""


def node_notes(
    plugins: Plugins, build_types: Iterable[str], distro: str, subjects: Iterable[Subject]
) -> tuple[Diagnostic, ...]:
    """Return one note for each thing that cannot start and each place, with the first subjects that it is about.

    Args:
        plugins: the plugins.
        build_types: names of the build types of the subjects; a transport that refuses nothing to a node says nothing.
        distro: ROS 2 distribution of the nodes.
        subjects: the subjects.
    """
    checks = [*map(plugins.build_type, dict.fromkeys(build_types))]
    together: dict[Diagnostic, list[str]] = {}
    for rules, where in subjects:
        for check in checks:
            for note in check.check_node(rules, distro):
                together.setdefault(replace(note, where=note.where or where, subject=""), []).append(rules.subject)
    return tuple(
        replace(note, message=f"{first_few(names, 3)}: {note.message}", subject=names[0] if len(names) == 1 else "")
        for note, names in together.items()
    )


def of_policy(policy: LoadedPolicy, subjects: Iterable[str]) -> Iterator[Subject]:
    """Yield the rules of subjects that have any, each with the place of the innermost profile that applies to it."""
    for subject in subjects:
        rules = policy.rules(subject)
        if rules is not None:
            profiles = policy.profiles(subject)
            yield rules, profiles[-1].where if profiles else None


def of_packages(
    session: Session, state: State, policy: LoadedPolicy, names: Iterable[str]
) -> tuple[tuple[Diagnostic, ...], State]:
    """Return the notes on some packages of a workspace, by what its policy says, and the record to go on with.

    The record tells that there are none, so that nothing is asked again while the policy is the same.

    Args:
        session: the workspace and its profile.
        state: the record.
        policy: its policy.
        names: the packages.

    Raises:
        KeymintError: the policy cannot be read.
    """
    subjects: dict[str, list[str]] = {}
    for name in names:
        for build_type in () if name in session.infrastructure() else recorded_build_types(session, name):
            subjects.setdefault(build_type, []).append(subject_of(name))
    distro, key = session.profile.distro, f"{SHARED}/nodes"
    asked = (part for build_type, own in subjects.items() for part in (build_type, *own, ""))
    inputs, stamp = digest(session.plugins.versions, distro, policy_digest(policy), *asked), state.stamp(STAGE, key)
    if stamp is not None and stamp.inputs == inputs:
        return (), state
    found = tuple(
        note
        for build_type, own in subjects.items()
        for note in node_notes(session.plugins, (build_type,), distro, of_policy(policy, own))
    )
    return found, state if found else state.updated(STAGE, {key: Stamp(inputs, {})})


def of_documents(
    reader: KeystoreReader, files: KeystoreFiles, enclaves: Sequence[FoundEnclave], distro: str
) -> list[Subject]:
    """Return the rules of the signed documents of a keystore; those that no policy can say are left out."""
    found: list[Subject] = []
    for each in enclaves:
        with suppress(KeymintError):
            granted = reader.granted(files, each, distro)
            found.append((granted.rules, Origin(granted.file)))
    return found
