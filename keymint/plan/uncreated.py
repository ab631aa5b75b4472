"""Subjects that a policy names and that have no source package: nothing of them is built, checked or proven."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.text import first_few
from keymint.api import LoadedPolicy
from keymint.plan.create import package_of
from keymint.plan.inputs import Inputs
from keymint.workspace import hidden_by

UNCREATED = "subjects-uncreated"
"""Code of the finding."""
_SHOWN = 5
"""Names that a message lists."""


def uncreated(inputs: Inputs, policy: LoadedPolicy, known: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return a finding on the subjects that the policy names exactly and that have no source package, if there are any.

    Some subjects only may be wanted here. But without any package nothing is looked at, and no verb may call that good.

    Args:
        inputs: the workspace.
        policy: its policy.
        known: names of its packages. Where there are none, subjects that a KEYMINT_IGNORE hides count as well: then
            nothing at all would be looked at.
    """
    src, created = inputs.workspace.src, set(known)
    missing = [name for name in (package_of(policy, subject) for subject in policy.subjects()) if name not in created]
    missing = [name for name in missing if not known or hidden_by(inputs.tree, src, name) is None]
    if not missing:
        return ()
    listed = first_few([f"/{name}" for name in missing], _SHOWN)
    what = "a subject that has" if len(missing) == 1 else f"{len(missing)} subjects that have"
    marker = hidden_by(inputs.tree, src, missing[0])
    return (
        Diagnostic(
            UNCREATED,
            Severity.NOTE if known else Severity.WARNING,
            f"the policy names {what} no source package: {listed}",
            Origin(inputs.workspace.shown(marker)) if marker else None,
            "remove this file" if marker else "run 'keymint create --all', then build and install",
        ),
    )
