# SPDX-License-Identifier: Apache-2.0
"""What pictures say in words: what is drawn, what stands for it, and what is not drawn."""

from __future__ import annotations

from collections.abc import Mapping

from comarmor.text import first_few, one_line, quantity
from keymint.api.graph import EdgeOutcome
from keymint.drawing.alike import Alike
from keymint.drawing.appearance import KINDS, OUTCOMES, object_name
from keymint.drawing.labelled_graph import LabelledGraph, LeftOut, namespace
from keymint.drawing.layout import NodeKey
from keymint.drawing.simplify import SimplifiedGraph

_MOST_GROUPS = 8
"""Groups of robots that a caption names."""


def alike_words(alike: Alike) -> str:
    """Return which robots are alike: ``30 robots like /r0 (/r0, /r1, /r2, /r3, /r4, …)``."""
    noun = "subjects" if alike.single else "robots"
    return one_line(f"{len(alike.names)} {noun} like {alike.like} ({first_few(alike.names)})")


def left_out_words(left_out: Mapping[LeftOut, int]) -> str:
    """Return how many edges of which kind are left out: ``12 allowed (10 topic, 2 service), 3 denied (3 action)``."""
    return ", ".join(
        f"{sum(counts.values())} {words} ({', '.join(f'{count} {KINDS[kind]}' for kind, count in counts.items())})"
        for outcome, words in OUTCOMES.items()
        if (counts := {kind: left_out[outcome, kind] for kind in KINDS if left_out.get((outcome, kind))})
    )


def left_out_json(left_out: Mapping[LeftOut, int]) -> list[dict[str, object]]:
    """Return the same for ``--json``."""
    return [{"outcome": one, "kind": kind, "edges": count} for (one, kind), count in sorted(left_out.items())]


def names_of(drawn: SimplifiedGraph) -> Mapping[NodeKey, str]:
    """Return the names of all subjects and objects that are drawn: of folded objects ``/talker/… (6 services)``."""
    names: dict[NodeKey, str] = {}
    for key, members in drawn.members.items():
        if isinstance(key, str):
            names[key] = one_line(key)
        elif len(members) > 1:
            noun = KINDS[key[1].kind].removesuffix("s")
            names[key] = one_line(f"{namespace(key[1].name)}… ({len(members)} {noun}s)")
        else:
            names[key] = object_name(key[1], key[0])
    return names


def size_words(labelled: LabelledGraph) -> str:
    """Return how large a graph is: the one count that all pictures and pages of it have."""
    objects = len({one.edge.domain_object for one in labelled.edges})
    counts = [(len(labelled.subjects), "subject"), (objects, "object"), (labelled.total - labelled.endpoints, "edge")]
    counts += [(labelled.endpoints, "single topic")] * (labelled.endpoints > 0)
    return ", ".join(quantity(count, noun) for count, noun in counts)


def subtitle(drawn: SimplifiedGraph) -> str:
    """Return the caption of a picture: what there is, and how it is drawn; no edge is left out in silence."""
    labelled, transport = drawn.labelled, drawn.options.transport
    notes = [size_words(labelled)]
    if labelled.transports:
        transports = labelled.transports if transport is None else [labelled.transports[transport]]
        which = transports[0] if len(transports) == 1 else "all transports"
        false = sum(one.outcome(transport).false for one in labelled.edges)
        notes.append(f"{one_line(which)} compared with the policy: {quantity(false, 'mismatch')}")
    if labelled.unnamed:
        others = one_line(first_few(labelled.unnamed))
        notes.append(f"not drawn: rights of other subjects like {others} (--subject NAME draws one)")
    largest = sorted(drawn.fold.classes, key=lambda each: -len(each.names))
    notes += (f"{alike_words(each)}, equal up to the name, are drawn as one" for each in largest[:_MOST_GROUPS])
    if len(largest) > _MOST_GROUPS:
        notes.append(f"so are {len(largest) - _MOST_GROUPS} smaller groups (--json has all names)")
    if drawn.marks:
        count = sum(one.common and one.outcome(transport) is EdgeOutcome.ALLOW for one in labelled.edges)
        notes.append(f"{quantity(count, 'common edge')} shown as marks")
    if any(len(members) > 1 for members in drawn.members.values()):
        notes.append("objects with the same edges are drawn as one")
    if drawn.left_out:
        count = sum(drawn.left_out.values())
        notes.append(f"NOT DRAWN: {count} of {labelled.total} edges: {left_out_words(drawn.left_out)}")
    elif drawn.folded:
        notes.append("no edge is left out")
    return "; ".join(notes)


def marks_of(drawn: SimplifiedGraph) -> Mapping[NodeKey, str]:
    """Return the second lines of boxes: how many robots they stand for, and how many common rules a subject has."""
    marks = {}
    for key, members in drawn.members.items():
        count, other, common = len(members[0]), key in drawn.fold.others, len(drawn.marks.get(key, ()))
        words = [f"{count} alike" + ", of every other robot" * other] * (other or count > 1)
        words += [f"+{common} common"] * (common > 0)
        if words:
            marks[key] = ", ".join(words)
    return marks
