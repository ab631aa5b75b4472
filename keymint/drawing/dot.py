"""Writes labelled graphs in Graphviz' DOT language, for those who lay out graphs themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from keymint.drawing.display_text import INWARD, OUTWARD, object_name, printable, role
from keymint.drawing.labelled_graph import EdgeOutcome, LabelledEdge, LabelledGraph
from keymint.drawing.legend import edge_classes
from keymint.drawing.options import DrawingOptions
from keymint.drawing.palette import LIGHT
from keymint.drawing.simplify import SimplifiedGraph, simplify
from keymint.drawing.words import sentence
from keymint.graph import Object


def dot(labelled: LabelledGraph, options: DrawingOptions | None = None) -> bytes:
    """Return a graph as a DOT document in UTF-8; ``dot -Tsvg`` draws it.

    Args:
        labelled: the graph.
        options: which transport, and how many edges; the rest is Graphviz' business.
    """
    options = options or DrawingOptions()
    drawn = simplify(labelled, replace(options, fold=False))
    edges = drawn.edges
    objects = {key: f"o{at}" for at, key in enumerate(sorted({(one.edge.domain, one.edge.object) for one in edges}))}
    subjects = {subject: f"s{at}" for at, subject in enumerate(drawn.groups)}
    lines = [
        "digraph keymint {",
        f"  graph [rankdir=LR, label={_quoted(labelled.title)}, labelloc=t, fontname=monospace]",
        "  node [style=filled, fontname=monospace]",
        *(f"  {at} [{_node('subject', _subject(name, drawn))}]" for name, at in subjects.items()),
        *(
            f"  {at} [{_node(found.kind, object_name(found, domain))}{_expression(found, labelled)}]"
            for (domain, found), at in objects.items()
        ),
        *(
            f"  {subjects[one.edge.subject]} -> {objects[one.edge.domain, one.edge.object]} "
            f"[{_attributes(one, labelled, options)}]"
            for one in edges
        ),
        "}",
    ]
    return ("\n".join(lines) + "\n").encode()


def _subject(name: str, drawn: SimplifiedGraph) -> str:
    common = drawn.marks.get(name)
    return printable(name) + (f" (+{len(common)} common)" if common else "")


def _quoted(text: str) -> str:
    r"""Return a quoted string of DOT; ``\`` would begin an escape in a label."""
    return '"' + printable(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _node(kind: str, label: str) -> str:
    shape = "ellipse" if kind == "subject" else "box"
    colours = f'fillcolor="{LIGHT[f"{kind}-fill"]}", color="{LIGHT[kind]}"'
    return f"label={_quoted(label)}, shape={shape}, {colours}"


def _expression(found: Object, labelled: LabelledGraph) -> str:
    return ', style="filled,dashed"' if found in labelled.patterns else ""


def _attributes(one: LabelledEdge, labelled: LabelledGraph, options: DrawingOptions) -> str:
    outcome = one.outcome(options.transport)
    out, into = role(one.edge.permission) in OUTWARD, role(one.edge.permission) in INWARD
    verdict = edge_classes(outcome, labels=False).partition(" ")[0]
    wanted: Mapping[str, str] = {
        "dir": "both" if out and into else "forward" if out else "back",
        "color": LIGHT[verdict],
        "style": "solid" if outcome.false or not labelled.transports else "dashed",
        "penwidth": "4" if outcome is EdgeOutcome.FALSE_ALLOW else "3" if outcome.false else "1",
        "arrowhead": "normal" if verdict != "deny" else "teeempty",
        "arrowtail": "normal" if verdict != "deny" else "teeempty",
        "label": " ".join(["DANGER"] * (outcome is EdgeOutcome.FALSE_ALLOW) + ["AUDIT"] * one.audit),
        "tooltip": sentence(one, labelled.transports),
    }
    return ", ".join(f"{name}={_quoted(value)}" for name, value in wanted.items() if value)
