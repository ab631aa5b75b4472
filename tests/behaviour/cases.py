# SPDX-License-Identifier: Apache-2.0
"""All cases by name. A name says in which module its case is: ``policies``, ``workspaces``, ``tampered``, ``verbs``."""

from __future__ import annotations

from collections.abc import Mapping

from . import policies, tampered, verbs, workspaces
from .record import Case


def all_cases(random_policies: int = 500) -> Mapping[str, Case]:
    """Return all cases by name, those that take longest first.

    Args:
        random_policies: how many policies of a generator.
    """
    return {
        **tampered.faults(),
        **verbs.CASES,
        **workspaces.CASES,
        **tampered.CASES,
        **policies.examples(),
        **policies.odd(),
        **policies.random(random_policies),
    }
