"""What a policy is likely not to mean, said where rights are built from it."""

from __future__ import annotations

from collections.abc import Iterable

from comarmor.errors import Diagnostic
from keymint.analysis.attachment_mistakes import attachment_mistakes
from keymint.analysis.subject_patterns import structure
from keymint.changes import Action, Step
from keymint.errors import KeymintError
from keymint.plan.policy import load_policy
from keymint.session import Session


def policy_slips(session: Session, steps: Iterable[Step]) -> tuple[Diagnostic, ...]:
    """Return likely slips in the policy of a workspace, if any step does something.

    Args:
        session: the workspace and its profile.
        steps: what is planned.
    """
    if all(step.action is Action.UNCHANGED for step in steps):
        return ()
    try:
        written = structure(load_policy(session))
    except KeymintError:
        return ()  # 'create' reads the policy, and says what is wrong with it; a build takes what was created
    return tuple(attachment_mistakes(written)) if written else ()
