"""The rules of a grant as they are written: texts only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from comarmor.rules import Effect
from keymint_ros2_dds.lowering.lower import Partitions
from keymint_ros2_dds.lowering.mapping import Action


@dataclass(frozen=True, slots=True)
class Criteria:
    """A rule of a grant.

    Attributes:
        effect: allow or deny.
        partitions: expressions of partitions, of all its criteria.
        topics: expressions of topics by action.
    """

    effect: Effect
    partitions: Partitions
    topics: Mapping[Action, tuple[str, ...]]


def is_name(text: str) -> bool:
    """Tell whether an expression matches no topic but the one of that name."""
    return not any(char in "*?[\\" for char in text)
