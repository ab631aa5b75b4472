# SPDX-License-Identifier: Apache-2.0
"""Graphs to draw, and names as an attacker would choose them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from hypothesis import strategies as st

from comarmor.errors import Origin
from comarmor.text import one_line
from keymint.api.graph import LABELLED, Edge, Object
from keymint.drawing.appearance import object_name
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph
from keymint.drawing.layout import NodeKey
from keymint.drawing.other_formats import dot_document, dot_simplified
from keymint.drawing.simplify import DrawingOptions

HOSTILE = "</script></style><img src=x onerror=alert(1)>\"'&\u202e\x01]]>"
ALLOWED, DENIED = Label(True, "an ALLOW rule", Origin("policy.xml", 3)), Label(False, "no rule")
EXPRESSLY_DENIED = Label(False, "a DENY rule", Origin("policy.xml", 7))


def edge(subject: str, permission: str, kind: str, name: str) -> Edge:
    return Edge(subject, permission, Object(kind, name))


def labelled(subject: str, permission: str, name: str, policy: Label | None, *transports: Label | None) -> LabelledEdge:
    kind = next(kind for kind, permissions in LABELLED.items() if permission in permissions)
    return LabelledEdge(edge(subject, permission, kind, name), policy, transports)


def names(edges: Iterable[LabelledEdge], subjects: Iterable[str]) -> Mapping[NodeKey, str]:
    """Return the names that a layout needs."""
    found: dict[NodeKey, str] = {subject: one_line(subject) for subject in subjects}
    return found | {one.edge.domain_object: object_name(one.edge.object, one.edge.domain) for one in edges}


def dot(labelled: LabelledGraph, options: DrawingOptions | None = None) -> bytes:
    return dot_document(dot_simplified(labelled, options or DrawingOptions()))


def one_of_each() -> LabelledGraph:
    """Return a graph with every outcome, on one transport."""
    return LabelledGraph.of(
        "talker and listener",
        [
            labelled("/talker", "ros_publish", "/chatter", ALLOWED, ALLOWED),
            labelled("/talker", "ros_subscribe", "/chatter", DENIED, DENIED),
            labelled("/listener", "ros_subscribe", "/chatter", ALLOWED, DENIED),
            labelled("/listener", "ros_call", "/talker/set_parameters", DENIED, ALLOWED),
        ],
        transports=["omg"],
    )


def fleet(robots: int) -> LabelledGraph:
    """Return a graph of robots with four nodes each."""
    names = [f"/robot{robot}/node{node}" for robot in range(robots) for node in range(4)]
    edges = [labelled(name, "ros_publish", "/fleet/state", ALLOWED) for name in names]
    return LabelledGraph.of("t", [*edges, labelled(names[0], "ros_publish", "/estop", EXPRESSLY_DENIED)])


def hostile() -> LabelledGraph:
    """Return a graph in which all text is hostile."""
    said = Label(True, HOSTILE, Origin(HOSTILE, 1, (Origin(HOSTILE, 2),)))
    found = Edge(f"/{HOSTILE}", "publish", Object("topic", HOSTILE, ("*", HOSTILE)), 3)
    return LabelledGraph.of(HOSTILE, [LabelledEdge(found, said, (DENIED,), audit=True)], transports=[HOSTILE])


NAMES = st.one_of(st.sampled_from(["/a", "/b", "/a/c", "/漢字", HOSTILE]), st.text(max_size=80))
SAID = st.sampled_from([None, ALLOWED, DENIED])


@st.composite
def graphs(draw: st.DrawFn, transports: int = 1) -> LabelledGraph:
    """Draw a graph of any shape."""
    subjects = draw(st.lists(NAMES, min_size=1, max_size=8, unique=True))
    found = {}
    for _ in range(draw(st.integers(0, 25))):
        kind = draw(st.sampled_from(sorted(LABELLED)))
        which = Edge(
            draw(st.sampled_from(subjects)),
            draw(st.sampled_from(LABELLED[kind])),
            Object(kind, draw(NAMES)),
            draw(st.integers(0, 1)),
        )
        said = tuple(draw(SAID) for _ in range(transports))
        found[which] = LabelledEdge(which, draw(SAID), said, draw(st.booleans()))
    return LabelledGraph.of("t", found.values(), subjects, [f"t{at}" for at in range(transports)])
