# SPDX-License-Identifier: Apache-2.0
"""Write the report on a labelled graph: one HTML file that works without network and without scripts.

A script adds search and filters. The page's content security policy allows only its own style sheet and script, by
their digests (Content Security Policy Level 3, 6.7.2.2). Names are always escaped.
"""

from __future__ import annotations

import base64
import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from typing import Any

from markupsafe import Markup

from comarmor.text import encodable_value, one_line
from keymint.api.graph import DomainObject, EdgeOutcome
from keymint.drawing.appearance import DARK, KIND_NAMES, KINDS, LIGHT, OUTCOMES, Theme, object_name
from keymint.drawing.captions import left_out_words, size_words
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph
from keymint.drawing.layout import NodeKey
from keymint.drawing.simplify import EXPLICIT, DrawingOptions, priority, simplify
from keymint.drawing.svg import draw, from_template, style_sheet
from keymint.errors import citation

MOST_ROWS = 10_000
"""Maximum number of edges in a report; false labels and explicit denials are listed beyond it. Next are allowed edges.
The report states the number of unlisted edges by kind."""


def html_report(labelled: LabelledGraph, sources: Mapping[str, bytes], picture: DrawingOptions | None = None) -> bytes:
    """Return a report as an HTML document in UTF-8; deterministic on every machine.

    Args:
        labelled: the graph.
        sources: contents of the files of the graph's origins, by the path in the origins.
        picture: drawing options of its picture; the theme follows the reader's preference.
    """
    keys: list[NodeKey] = [*labelled.subjects, *sorted({one.edge.domain_object for one in labelled.edges})]
    number = {key: at for at, key in enumerate(keys)}.__getitem__
    of_object: dict[DomainObject, list[tuple[LabelledEdge, EdgeOutcome]]] = defaultdict(list)
    for one in sorted(labelled.edges, key=lambda one: one.edge.domain_object):
        of_object[one.edge.domain_object].append((one, one.outcome()))
    listed = listed_edges(labelled)
    rows: dict[str, list[LabelledEdge]] = defaultdict(list)
    for one in listed:
        rows[one.edge.subject].append(one)
    files = {name: at for at, name in enumerate(sources)}

    def links(label: Label) -> Iterator[tuple[str, str]]:
        """Yield the places of a rule, each with where the page has it; empty without the file."""
        for place in (label.where, *label.where.chain) if label.where else ():
            at = files.get(place.file)
            target = "" if at is None else f"f{at}-{place.line}" if place.line else f"f{at}"
            yield citation(place.file, place.line, place.source), target

    missing = labelled.left_out(listed)
    drawn = draw(simplify(labelled, picture or DrawingOptions()), number) if labelled.edges else ""
    context = {
        "graph": labelled,
        "counts": labelled.counts,
        "outcomes": OUTCOMES,
        "kinds": KINDS,
        "size": size_words(labelled),
        "has_policy": any(one.policy for one in labelled.edges),
        "rows": rows,
        "differences": [one for of_subject in rows.values() for one in of_subject if one.outcome().false],
        "picture": Markup(drawn),  # noqa: S704 - escaped
        "of_object": of_object,
        "unlisted": sum(missing.values()),
        "missing": left_out_words(missing),
        "sources": {name: _lines(content) for name, content in sources.items()},
        "number": number,
        "links": links,
        "object_name": object_name,
    }
    return _page("report.html.j2", context, style_sheet(Theme.AUTO), _template_text("report.js"))


def audit_page(document: Mapping[str, Any]) -> bytes:
    """Return the page of ``keymint report``, which has no script, in UTF-8.

    Args:
        document: the report; ``docs/json.md`` describes it.
    """
    return _page("audit.html.j2", encodable_value(document), _template_text("audit.css"))


def _page(template: str, context: Mapping[str, Any], style: str, script: str = "") -> bytes:
    """Return a page with the common style sheet, and with a style sheet and perhaps a script of its own."""
    own = {"style": from_template("report.css.j2", kinds=KIND_NAMES, light=LIGHT, dark=DARK) + style, "script": script}
    digests = {name: base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for name, text in own.items()}
    sources = "".join(f"{name}-src 'sha256-{digest}'; " for name, digest in digests.items() if own[name])
    policy = f"default-src 'none'; {sources}base-uri 'none'; form-action 'none'"
    markup = {name: Markup(text) for name, text in own.items()}  # noqa: S704 - ours
    return from_template(template, policy=policy, **markup, **context).encode()


def _template_text(name: str) -> str:
    return resources.files(__package__).joinpath("templates", name).read_text(encoding="utf-8")


def _lines(content: bytes) -> list[Markup]:
    lines = content.decode("utf-8", "replace").split("\n")
    return [Markup("\t").join(map(one_line, line.removesuffix("\r").split("\t"))) for line in lines]


def listed_edges(labelled: LabelledGraph) -> Sequence[LabelledEdge]:
    """Return the edges that a report lists, the most important ones first."""
    needed = sum(priority(one) <= EXPLICIT for one in labelled.edges)
    return sorted(labelled.edges, key=priority)[: max(MOST_ROWS, needed)]
