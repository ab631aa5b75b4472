"""What several subjects need alike, moved to files that their profiles include, where that makes the whole shorter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from keymint_ros2_comarmor.learned_rules import Need, Needs, fold, literal, literal_needs, templates
from keymint_ros2_comarmor.writing import fragment_size, include_size, rules_size

NAME = "common_{number}.xml"


@dataclass(frozen=True, slots=True)
class CommonPart:
    """What several subjects need alike.

    Attributes:
        name: file name.
        subjects: who includes it.
        needs: its needs, as attachments in which ``{namespace}`` and ``{name}`` may stand.
        covered: for each subject, its own needs (with names) that are stated here.
    """

    name: str
    subjects: tuple[str, ...]
    needs: frozenset[Need]
    covered: Mapping[str, frozenset[Need]] = field(repr=False)


def share(needs: Mapping[str, Needs]) -> tuple[CommonPart, ...]:
    """Return the common parts that make the policy shorter, counted in bytes of all its files.

    Needs that the same subjects have are one candidate; those of most subjects are tried first.
    """
    remaining = literal_needs(needs)
    parts: list[CommonPart] = []
    for subjects, stated in sorted(_candidates(remaining).items(), key=lambda item: (-len(item[0]), item[0])):
        covered = {subject: frozenset(found.values()) for subject, found in stated.items()}
        common = frozenset(next(iter(stated.values())))
        if _saved(subjects, common, covered, remaining) > 0:
            for subject, found in covered.items():
                remaining[subject] -= found
            parts.append(CommonPart(NAME.format(number=len(parts) + 1), subjects, common, covered))
    return tuple(parts)


def _candidates(needs: Mapping[str, set[Need]]) -> dict[tuple[str, ...], dict[str, dict[Need, Need]]]:
    """Return, by the subjects that agree: for each subject its needs by the template that states them."""
    holders: dict[Need, set[str]] = {}
    for subject, found in needs.items():
        for need in found:
            for template in templates(need, subject):
                holders.setdefault(template, set()).add(subject)
    groups: dict[tuple[str, ...], dict[str, dict[Need, Need]]] = {}
    for subject, found in needs.items():
        for need in found:
            best = max(templates(need, subject), key=lambda template: len(holders[template]))
            if len(holders[best]) > 1:
                groups.setdefault(tuple(sorted(holders[best])), {}).setdefault(subject, {})[best] = need
    agreed = {subjects: _agreed(subjects, stated) for subjects, stated in groups.items()}
    return {subjects: stated for subjects, stated in agreed.items() if stated}


def _agreed(chosen: tuple[str, ...], stated: Mapping[str, Mapping[Need, Need]]) -> dict[str, dict[Need, Need]]:
    """Return what all subjects of a group state alike, or nothing: some may share a need better in another way."""
    if len(stated) < len(chosen):
        return {}
    common = frozenset.intersection(*(frozenset(found) for found in stated.values()))
    return {subject: {one: found[one] for one in common} for subject, found in stated.items()} if common else {}


def _saved(
    subjects: tuple[str, ...],
    common: frozenset[Need],
    covered: Mapping[str, frozenset[Need]],
    remaining: Mapping[str, set[Need]],
) -> int:
    """Return the bytes that a common part saves."""
    saved = -fragment_size(fold(common))
    for subject in subjects:
        before = rules_size(fold(map(literal, remaining[subject])))
        after = rules_size(fold(map(literal, remaining[subject] - covered[subject])))
        saved += before - after - include_size()
    return saved
