"""The legend of a picture: what a reader needs to know of it, and no more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from keymint.drawing.layout import CHARACTER, Panel
from keymint.drawing.model import Labelled, Outcome
from keymint.drawing.simplify import Simplified
from keymint.drawing.text import INWARD, KINDS, OUTWARD, columns, role

LINE = 22.0
"""Height of a line of text, in pixels."""


@dataclass(frozen=True, slots=True)
class Sample:
    """An entry of the legend.

    Attributes:
        text: what it says.
        classes: of the style sheet.
        form: ``box``, ``dot``, ``arrow``, ``barred``, ``both`` or ``mark``: what is drawn beside it.
        x: in pixels.
        y: in pixels.
    """

    text: str
    classes: str
    form: str
    x: float = 0.0
    y: float = 0.0


def legend(labelled: Labelled, drawn: Simplified, panels: Sequence[Panel], transport: int | None) -> Iterator[Sample]:
    """Yield the entries of a legend.

    Args:
        labelled: the graph.
        drawn: what is drawn of it.
        panels: what is drawn.
        transport: index of the transport whose labels are drawn; None for all together.
    """
    yield from _boxes(labelled, drawn, panels)
    roles = {role(one.edge.permission) for one in drawn.edges}
    for direction, form in ((OUTWARD, "out"), (INWARD, "in")):
        named = [name for name in direction if name in roles and name != "relay"]
        if named:
            towards = "object" if form == "out" else "subject"
            yield Sample(f"to the {towards}: {', '.join(named)}", "plain", "arrow")
    if "relay" in roles:
        yield Sample("both ways: relay", "plain", "both")
    outcomes = {one.outcome(transport) for one in drawn.edges}
    labels = bool(labelled.transports)
    words = {
        Outcome.ALLOW: "allowed, as the policy says" if labels else "allowed",
        Outcome.DENY: "denied, as the policy says" if labels else "denied",
        Outcome.FALSE_ALLOW: "DANGER: allowed against the policy (false positive)",
        Outcome.FALSE_DENY: "denied against the policy (false negative)",
    }
    for outcome, text in words.items():
        if outcome in outcomes:
            yield Sample(text, edge_classes(outcome, labels=labels), "arrow" if outcome.allowed else "barred")
    if any(one.audit for one in drawn.edges):
        yield Sample("AUDIT: to be watched", "audited", "dot")
    if drawn.marks:
        yield Sample("what every node may do (--common draws it)", "muted", "mark")


def _boxes(labelled: Labelled, drawn: Simplified, panels: Sequence[Panel]) -> Iterator[Sample]:
    """Yield the entries on subjects and objects."""
    kinds = {box.kind for panel in panels for box in panel.boxes}
    yield Sample("subject", "subject", "box")
    if any(len(members) > 1 for members in drawn.groups.values()):
        yield Sample("subjects of a namespace", "subject group", "box")
    for kind, name in KINDS.items():
        if kind in kinds:
            yield Sample(name, kind, "box")
    if any(one.edge.object in labelled.patterns for one in drawn.edges):
        yield Sample("expression", "pattern neutral", "box")


def flowed(samples: Sequence[Sample], width: float) -> tuple[list[Sample], float]:
    """Place entries in lines of that width, in pixels; return them, and the height of all."""
    x = y = 0.0
    placed = []
    for sample in samples:
        needed = 40 + columns(sample.text) * CHARACTER + 18
        if x and x + needed > width:
            x, y = 0.0, y + LINE
        placed.append(replace(sample, x=round(x, 1), y=y))
        x += needed
    return placed, y + LINE


def edge_classes(outcome: Outcome, *, labels: bool) -> str:
    """Return the classes of an edge in the style sheet; with ``labels`` of transports they are true or false."""
    if outcome is Outcome.UNLABELLED:
        return "plain"
    if outcome is Outcome.FALSE_ALLOW:
        return "danger false"
    verdict = "allow" if outcome.allowed else "deny"
    return f"{verdict} {'false' if outcome.false else 'true'}" if labels else verdict
