# SPDX-License-Identifier: Apache-2.0
"""Find files of the policy library that grant what SROS2's common files grant to a node."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from pathlib import Path

from comarmor.errors import ComArmorError
from comarmor.language.loading import load_included
from comarmor.language.policy import Policy
from comarmor.rules import Effect, Rule

Atom = tuple[Effect, str, str, str]
"""Effect, kind, permission and expression of a part of a rule."""
_FOLDER = "common"


def atoms(rules: Collection[Rule]) -> frozenset[Atom]:
    """Return the parts of rules: one for each effect, kind, permission and expression."""
    return frozenset(
        (rule.effect, rule.kind, permission, expression)
        for rule in rules
        for permission in rule.permissions
        for expression in rule.expressions
    )


def common_files(library: Path, subject: str, wanted: Collection[Atom]) -> dict[str, frozenset[Atom]]:
    """Return files of the library that a profile of a subject may include in place of rules, with what they grant.

    Args:
        library: folder of the library.
        subject: the subject.
        wanted: what the subject is granted; nothing beyond it is granted by the files.
    """
    left = set(wanted)
    found: dict[str, frozenset[Atom]] = {}
    candidates = [(name, atoms(policy.rules(subject))) for name, policy in _policies(library)]
    for name, granted in sorted(candidates, key=lambda each: (-len(each[1]), each[0])):
        if granted and granted <= left:
            found[name] = granted
            left -= granted
    return found


@lru_cache(maxsize=4)
def _policies(library: Path) -> tuple[tuple[str, Policy], ...]:
    """Return the files of the library, each in a profile for all subjects; without those that need a tunable."""
    found: list[tuple[str, Policy]] = []
    for path in sorted((library / _FOLDER).rglob("*.xml")):
        name = path.relative_to(library).as_posix()
        try:
            found.append((name, load_included(name, name, library)))
        except ComArmorError as error:
            if any(each.code != "tunable" for each in error.diagnostics):
                raise
    return tuple(found)
