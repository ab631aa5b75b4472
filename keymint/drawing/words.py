"""What pictures and reports say of graphs, in words."""

from __future__ import annotations

from collections.abc import Sequence

from keymint.drawing.display_text import object_name, printable
from keymint.drawing.labelled_graph import Label, LabelledEdge


def sentence(labelled: LabelledEdge, transports: Sequence[str]) -> str:
    """Return an edge and all that is said about it on one line."""
    edge = labelled.edge
    layers = [("policy", labelled.policy), *zip(transports, labelled.transports, strict=True)]
    said = "; ".join(f"{name}: {_said(one)}" for name, one in layers if one is not None)
    text = f"{edge.subject} {edge.permission} {object_name(edge.object, edge.domain)}"
    return printable(text + (f" - {said}" if said else "") + (" (AUDIT)" if labelled.audit else ""))


def _said(said: Label) -> str:
    because = ": ".join(filter(None, (str(said.where) if said.where else "", said.reason)))
    return ("allowed" if said.allowed else "denied") + (f" ({because})" if because else "")
