# SPDX-License-Identifier: Apache-2.0
"""Move rules that several subjects share into included files, where that makes the policy shorter."""

from __future__ import annotations

from collections.abc import Mapping

from keymint_ros2_comarmor.learned_document import INCLUDE_SIZE, fragment_size, profile_size
from keymint_ros2_comarmor.learned_rules import CommonPart, Need, fold, literal, templates

_NAME = "common_{number}.xml"


def share(needs: Mapping[str, set[Need]]) -> tuple[CommonPart, ...]:
    """Return the common parts that make the policy shorter, in bytes of all its files.

    The needs that a group of subjects shares are one candidate. Larger groups are tried first.
    """
    remaining = {subject: set(own_needs) for subject, own_needs in needs.items()}
    parts: list[CommonPart] = []
    for subjects, shared in sorted(_candidates(remaining).items(), key=lambda item: (-len(item[0]), item[0])):
        covered = {subject: frozenset(by_template.values()) for subject, by_template in shared.items()}
        common = frozenset(next(iter(shared.values())))
        if _saved_bytes(subjects, common, covered, remaining) > 0:
            for subject, own_needs in covered.items():
                remaining[subject] -= own_needs
            parts.append(CommonPart(_NAME.format(number=len(parts) + 1), subjects, common, covered))
    return tuple(parts)


def _candidates(needs: Mapping[str, set[Need]]) -> dict[tuple[str, ...], dict[str, dict[Need, Need]]]:
    """Return the candidates by group of subjects: for each subject its needs by their common template."""
    holders: dict[Need, set[str]] = {}
    for subject, own_needs in needs.items():
        for need in own_needs:
            for template in templates(need, subject):
                holders.setdefault(template, set()).add(subject)
    groups: dict[tuple[str, ...], dict[str, dict[Need, Need]]] = {}
    for subject, own_needs in needs.items():
        for need in own_needs:
            best = max(templates(need, subject), key=lambda template: len(holders[template]))
            if len(holders[best]) > 1:
                groups.setdefault(tuple(sorted(holders[best])), {}).setdefault(subject, {})[best] = need
    shared = {subjects: _shared_by_all(subjects, group) for subjects, group in groups.items()}
    return {subjects: group for subjects, group in shared.items() if group}


def _shared_by_all(subjects: tuple[str, ...], group: Mapping[str, Mapping[Need, Need]]) -> dict[str, dict[Need, Need]]:
    """Return the needs that all subjects of a group share; empty if some share theirs better in another group."""
    if len(group) < len(subjects):
        return {}
    common = frozenset.intersection(*(frozenset(by_template) for by_template in group.values()))
    if not common:
        return {}
    return {subject: {each: by_template[each] for each in common} for subject, by_template in group.items()}


def _saved_bytes(
    subjects: tuple[str, ...],
    common: frozenset[Need],
    covered: Mapping[str, frozenset[Need]],
    remaining: Mapping[str, set[Need]],
) -> int:
    """Return the bytes that a common part saves."""
    saved = -fragment_size(fold(common))
    for subject in subjects:
        before = profile_size(fold(map(literal, remaining[subject])))
        after = profile_size(fold(map(literal, remaining[subject] - covered[subject])))
        saved += before - after - INCLUDE_SIZE
    return saved
