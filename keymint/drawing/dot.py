# SPDX-License-Identifier: Apache-2.0
"""Write labelled graphs in Graphviz' DOT language, for other layouts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from comarmor.text import printable
from keymint.api.graph import EdgeOutcome, Object
from keymint.drawing.appearance import LIGHT, directions, edge_classes, object_name, sentence
from keymint.drawing.labelled_graph import LabelledEdge, LabelledGraph
from keymint.drawing.simplify import DrawingOptions, SimplifiedGraph, simplify


def dot(labelled: LabelledGraph, options: DrawingOptions | None = None) -> bytes:
    """Return a graph as a DOT document in UTF-8; ``dot -Tsvg`` draws it.

    Args:
        labelled: the graph.
        options: the transport and the number of edges; others are ignored.
    """
    options = options or DrawingOptions()
    drawn = simplify(labelled, replace(options, fold=False))
    edges = drawn.edges
    objects = {key: f"o{at}" for at, key in enumerate(sorted({one.edge.domain_object for one in edges}))}
    subjects = {subject: f"s{at}" for at, subject in enumerate(drawn.groups)}
    lines = [
        "digraph keymint {",
        f"  graph [rankdir=LR, label={_quoted(labelled.title)}, labelloc=t, fontname=monospace]",
        "  node [style=filled, fontname=monospace]",
        *(f"  {at} [{_node('subject', _subject(name, drawn))}]" for name, at in subjects.items()),
        *(
            f"  {at} [{_node(object_.kind, object_name(object_, domain))}{_style(object_, labelled)}]"
            for (domain, object_), at in objects.items()
        ),
        *(
            f"  {subjects[one.edge.subject]} -> {objects[one.edge.domain_object]} "
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
    r"""Return a quoted string of DOT; an unescaped ``\`` starts an escape in a label."""
    return '"' + printable(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _node(kind: str, label: str) -> str:
    shape = "ellipse" if kind == "subject" else "box"
    colours = f'fillcolor="{LIGHT[f"{kind}-fill"]}", color="{LIGHT[kind]}"'
    return f"label={_quoted(label)}, shape={shape}, {colours}"


def _style(object_: Object, labelled: LabelledGraph) -> str:
    return ', style="filled,dashed"' if object_ in labelled.patterns else ""


def _attributes(one: LabelledEdge, labelled: LabelledGraph, options: DrawingOptions) -> str:
    outcome = one.outcome(options.transport)
    out, into = directions(one.edge.permission)
    verdict = edge_classes(outcome, labels=False).partition(" ")[0]
    attributes: Mapping[str, str] = {
        "dir": "both" if out and into else "forward" if out else "back",
        "color": LIGHT[verdict],
        "style": "solid" if outcome.false or not labelled.transports else "dashed",
        "penwidth": "4" if outcome is EdgeOutcome.FALSE_POSITIVE else "3" if outcome.false else "1",
        "arrowhead": "normal" if verdict != "deny" else "teeempty",
        "arrowtail": "normal" if verdict != "deny" else "teeempty",
        "label": " ".join(["DANGER"] * (outcome is EdgeOutcome.FALSE_POSITIVE) + ["AUDIT"] * one.audit),
        "tooltip": sentence(one, labelled.transports),
    }
    return ", ".join(f"{name}={_quoted(value)}" for name, value in attributes.items() if value)
