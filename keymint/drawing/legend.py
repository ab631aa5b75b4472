# SPDX-License-Identifier: Apache-2.0
"""The legend of a picture: entries for what the picture contains, and no others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from comarmor.values import dataclass
from keymint.api.graph import EdgeOutcome
from keymint.drawing.display_text import INWARD, KINDS, OUTCOMES, OUTWARD, columns, role
from keymint.drawing.labelled_graph import LabelledGraph
from keymint.drawing.layout import CHARACTER, Panel
from keymint.drawing.simplify import SimplifiedGraph

LINE = 22.0
"""Height of a line of text, in pixels."""


@dataclass(frozen=True, slots=True)
class LegendEntry:
    """An entry of the legend.

    Attributes:
        text: its text.
        classes: of the style sheet.
        form: what is drawn beside the text: ``box``, ``dot``, ``arrow``, ``barred``, ``both`` or ``mark``.
        x: in pixels.
        y: in pixels.
    """

    text: str
    classes: str
    form: str
    x: float = 0.0
    y: float = 0.0


def legend(
    labelled: LabelledGraph, drawn: SimplifiedGraph, panels: Sequence[Panel], transport: int | None
) -> Iterator[LegendEntry]:
    """Yield the entries of a legend.

    Args:
        labelled: the graph.
        drawn: the part of it that is drawn.
        panels: its layout.
        transport: index of the transport whose labels are drawn; None for all together.
    """
    yield from _boxes(labelled, drawn, panels)
    roles = {role(one.edge.permission) for one in drawn.edges}
    for target, directed in (("object", OUTWARD), ("subject", INWARD)):
        named = [name for name in directed if name in roles and name != "relay"]
        if named:
            yield LegendEntry(f"to the {target}: {', '.join(named)}", "plain", "arrow")
    if "relay" in roles:
        yield LegendEntry("both ways: relay", "plain", "both")
    outcomes = {one.outcome(transport) for one in drawn.edges}
    labels = bool(labelled.transports)
    compared = {EdgeOutcome.ALLOW: " (true positive)", EdgeOutcome.DENY: " (true negative)"} if labels else {}
    for outcome in (EdgeOutcome.ALLOW, EdgeOutcome.DENY, EdgeOutcome.FALSE_POSITIVE, EdgeOutcome.FALSE_NEGATIVE):
        if outcome in outcomes:
            text = OUTCOMES[outcome] + compared.get(outcome, "")
            yield LegendEntry(text, edge_classes(outcome, labels=labels), "arrow" if outcome.allowed else "barred")
    if any(one.audit for one in drawn.edges):
        yield LegendEntry("AUDIT rule", "audited", "dot")
    if drawn.marks:
        yield LegendEntry("what every node may do (--common draws it)", "muted", "mark")


def _boxes(labelled: LabelledGraph, drawn: SimplifiedGraph, panels: Sequence[Panel]) -> Iterator[LegendEntry]:
    """Yield the entries on subjects and objects."""
    kinds = {box.kind for panel in panels for box in panel.boxes}
    yield LegendEntry("subject", "subject", "box")
    if any(len(members) > 1 for members in drawn.groups.values()):
        yield LegendEntry("subjects of a namespace", "subject group", "box")
    for kind, name in KINDS.items():
        if kind in kinds:
            yield LegendEntry(name, kind, "box")
    if any(one.edge.object in labelled.patterns for one in drawn.edges):
        yield LegendEntry("expression", "pattern neutral", "box")


def place_entries(entries: Sequence[LegendEntry], width: float) -> tuple[list[LegendEntry], float]:
    """Place entries in lines of a width in pixels; return them and their total height."""
    x = y = 0.0
    placed = []
    for entry in entries:
        needed = 40 + columns(entry.text) * CHARACTER + 18
        if x and x + needed > width:
            x, y = 0.0, y + LINE
        placed.append(replace(entry, x=round(x, 1), y=y))
        x += needed
    return placed, y + LINE


def edge_classes(outcome: EdgeOutcome, *, labels: bool) -> str:
    """Return the style sheet classes of an edge; with ``labels`` of transports also ``true`` or ``false``."""
    if outcome is EdgeOutcome.UNLABELLED:
        return "plain"
    if outcome is EdgeOutcome.FALSE_POSITIVE:
        return "danger false"
    verdict = "allow" if outcome.allowed else "deny"
    return f"{verdict} {'false' if outcome.false else 'true'}" if labels else verdict
