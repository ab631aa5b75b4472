# SPDX-License-Identifier: Apache-2.0
"""Options for drawing a graph."""

from __future__ import annotations

from enum import StrEnum

from comarmor.values import dataclass
from keymint.drawing.palette import Theme


class Split(StrEnum):
    """How a picture is split into panels."""

    NONE = "none"
    SUBJECT = "subject"
    NAMESPACE = "namespace"


@dataclass(frozen=True, slots=True)
class DrawingOptions:
    """Options for drawing a graph.

    Attributes:
        theme: colours.
        split: one panel, or one per subject or namespace of subjects.
        transport: index of the transport whose labels are drawn; None for all together.
        limit: the maximum number of edges; see :func:`keymint.drawing.simplify.shown_edges`.
        fold: draw objects with the same edges as one; None does so in large graphs only.
        group: draw the subjects of a namespace as one; None does so in large graphs only.
        common: draw the edges of common rules; False puts a mark at the subject instead.
    """

    theme: Theme = Theme.AUTO
    split: Split = Split.NONE
    transport: int | None = None
    limit: int = 600
    fold: bool | None = None
    group: bool | None = None
    common: bool = False
