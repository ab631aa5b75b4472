# SPDX-License-Identifier: Apache-2.0
"""Report where the source packages do not follow the policy: changed rules, and subjects without a package."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.errors import Diagnostic, Severity
from comarmor.text import counted, first_few
from keymint.api import LoadedPolicy
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.stages.create import stale
from keymint.workspace.policy_loading import is_recorded, is_unchanged, load_policy, package_of, recorded_subjects
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import hidden_by

CHANGED = "policy-changed"
"""Code of the warning that packages are not what the policy says now."""
UNCREATED = "subjects-uncreated"
"""Code of the finding on subjects that have no source package."""


def policy_changed(session: Session) -> tuple[Diagnostic, ...]:
    """Return a warning if the packages were created from another policy.

    The record is only a hint: a comment, another default of the profile or a copy of the workspace changes no package.
    So the policy is loaded and compared with the packages where the record differs.
    """
    if not is_recorded(session) or is_unchanged(session):
        return ()
    try:
        names = _changed_packages(session)
    except KeymintError as error:
        message = f"the policy changed since the packages were created, and cannot be read: {error.diagnostics[0]}"
        return (Diagnostic.warning(CHANGED, message, None, "fix it, then run 'keymint create --all'"),)
    if not names:
        return ()
    shown = first_few([subject_of(name) for name in names])
    message = f"{counted(len(names), 'source package')} out of date with the policy: {shown}"
    return (Diagnostic.warning(CHANGED, message, None, "run 'keymint create --all'"),)


def _changed_packages(session: Session) -> list[str]:
    """Return the packages that differ from the policy, and those of subjects that it did not name before."""
    policy = load_policy(session)
    existing = session.packages()
    before = recorded_subjects(session)
    new = {package_of(policy, subject) for subject in policy.subjects() if subject not in before}
    return sorted({*stale(session, policy, existing), *(new - set(existing))})


def subjects_without_package(inputs: Inputs, policy: LoadedPolicy, known: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return a finding on the subjects that the policy names exactly and that have no source package, if any.

    A workspace may deliberately create some subjects only. But without any package nothing is checked, and no verb may
    report that as success.

    Args:
        inputs: the workspace.
        policy: its policy.
        known: names of its packages. If there are none, subjects that a KEYMINT_IGNORE hides count as well, because
            otherwise nothing at all would be checked.
    """
    src, created = inputs.workspace.src, set(known)
    missing = [name for name in (package_of(policy, subject) for subject in policy.subjects()) if name not in created]
    missing = [name for name in missing if not known or hidden_by(inputs.tree, src, name) is None]
    if not missing:
        return ()
    shown = first_few([subject_of(name) for name in missing])
    subjects = "a subject that has" if len(missing) == 1 else f"{len(missing)} subjects that have"
    marker = hidden_by(inputs.tree, src, missing[0])
    return (
        Diagnostic(
            UNCREATED,
            Severity.NOTE if known else Severity.WARNING,
            f"the policy names {subjects} no source package: {shown}",
            inputs.workspace.origin(marker) if marker else None,
            "remove this file" if marker else "run 'keymint create --all', then build and install",
        ),
    )
