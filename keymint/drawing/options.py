"""How a graph is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from keymint.drawing.palette import Theme


class Split(StrEnum):
    """Into which panels a picture is divided."""

    NONE = "none"
    SUBJECT = "subject"
    NAMESPACE = "namespace"


@dataclass(frozen=True, slots=True)
class DrawingOptions:
    """How a graph is drawn.

    Attributes:
        theme: colours.
        split: one panel, or one per subject or namespace of subjects.
        transport: index of the transport whose labels are drawn; None for all together.
        limit: the most edges that are drawn; see :func:`keymint.drawing.simplify.shown_edges`.
        fold: draw objects that nothing tells apart as one; None does so in large graphs.
        group: draw the subjects of a namespace as one; None does so in large graphs.
        common: draw what every node may do; False puts a mark at the subject in its place.
    """

    theme: Theme = Theme.AUTO
    split: Split = Split.NONE
    transport: int | None = None
    limit: int = 600
    fold: bool | None = None
    group: bool | None = None
    common: bool = False
