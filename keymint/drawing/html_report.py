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

from comarmor.errors import citation
from comarmor.text import encodable_value, one_line
from keymint.api.graph import DomainObject, EdgeOutcome
from keymint.drawing.appearance import DARK, KIND_NAMES, KINDS, LIGHT, OUTCOMES, Theme, object_name
from keymint.drawing.captions import left_out_words, size_words
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph
from keymint.drawing.layout import NodeKey
from keymint.drawing.simplify import EXPLICIT, DrawingOptions, priority, simplify
from keymint.drawing.svg import draw, rendered, style_sheet

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
    page = _Page(labelled, tuple(sources), picture or DrawingOptions())
    rows = page.rows()
    counts = labelled.counts
    missing = labelled.left_out(listed_edges(labelled))
    context = {
        "title": one_line(labelled.title),
        "size": size_words(labelled),
        "made": [one_line(text) for text in labelled.made],
        "verdicts": [
            {"value": outcome, "words": words, "count": count}
            for outcome, words in OUTCOMES.items()
            if (count := counts[outcome])
        ],
        "transports": page.transports,
        "has_policy": any(one.policy for one in labelled.edges),
        "confusions": [(name, labelled.confusion(at)) for at, name in enumerate(page.transports)],
        "differences": [row for of_subject in rows.values() for row in of_subject if row["wrong"]],
        "picture": Markup(draw(page.drawn, page.number)) if labelled.edges else "",  # noqa: S704 - escaped
        "subjects": [
            {"name": one_line(name), "number": page.number(name), "rows": rows[name]} for name in labelled.subjects
        ],
        "objects": page.object_rows(),
        "unlisted": sum(missing.values()),
        "missing": left_out_words(missing),
        "sources": [
            {"name": one_line(name), "at": at, "lines": [*_lines(content)]}
            for at, (name, content) in enumerate(sources.items())
        ],
    }
    return _page("report.html.j2", context, style_sheet(Theme.AUTO), _template_text("report.js"))


def audit_page(document: Mapping[str, Any]) -> bytes:
    """Return the page of ``keymint report``, which has no script, in UTF-8.

    Args:
        document: the report; ``docs/json.md`` describes it.
    """
    return _page("audit.html.j2", _printable(encodable_value(document)), _template_text("audit.css"))


def _printable(value: Any) -> Any:
    """Return a value with every text in it on one line, without characters that hide or reorder others."""
    if isinstance(value, str):
        return one_line(value)
    if isinstance(value, Mapping):
        return {one_line(key): _printable(item) for key, item in value.items()}
    return [*map(_printable, value)] if isinstance(value, Sequence) else value


def _page(template: str, context: Mapping[str, Any], style: str, script: str = "") -> bytes:
    """Return a page with the common style sheet, and with a style sheet and perhaps a script of its own."""
    own = {"style": rendered("report.css.j2", kinds=KIND_NAMES, light=LIGHT, dark=DARK) + style, "script": script}
    digests = {name: base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for name, text in own.items()}
    sources = "".join(f"{name}-src 'sha256-{digest}'; " for name, digest in digests.items() if own[name])
    policy = f"default-src 'none'; {sources}base-uri 'none'; form-action 'none'"
    markup = {name: Markup(text) for name, text in own.items()}  # noqa: S704 - ours
    return rendered(template, policy=policy, **markup, **context).encode()


def _template_text(name: str) -> str:
    return resources.files(__package__).joinpath("templates", name).read_text(encoding="utf-8")


def _lines(content: bytes) -> Iterator[str]:
    for line in content.decode("utf-8", "replace").split("\n"):
        yield "\t".join(one_line(part) for part in line.removesuffix("\r").split("\t"))


def listed_edges(labelled: LabelledGraph) -> Sequence[LabelledEdge]:
    """Return the edges that a report lists, the most important ones first."""
    needed = sum(priority(one) <= EXPLICIT for one in labelled.edges)
    return sorted(labelled.edges, key=priority)[: max(MOST_ROWS, needed)]


class _Page:
    """Numbers, rows and links of a report."""

    def __init__(self, labelled: LabelledGraph, sources: Sequence[str], options: DrawingOptions) -> None:
        self._labelled = labelled
        self._sources = {name: at for at, name in enumerate(sources)}
        self.transports = [one_line(name) for name in labelled.transports]
        self.objects: list[DomainObject] = sorted({one.edge.domain_object for one in labelled.edges})
        self.drawn = simplify(labelled, options)
        keys: list[NodeKey] = [*labelled.subjects, *self.objects]
        self._numbers = {key: at for at, key in enumerate(keys)}

    def number(self, key: NodeKey) -> int:
        """Return the number of a subject or object."""
        return self._numbers[key]

    def rows(self) -> Mapping[str, Sequence[Mapping[str, Any]]]:
        """Return the listed edges by subject, the most important ones first."""
        rows: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
        for one in listed_edges(self._labelled):
            rows[one.edge.subject].append(self._row(one))
        return rows

    def _row(self, one: LabelledEdge) -> Mapping[str, Any]:
        edge, outcome = one.edge, one.outcome()
        return {
            "outcome": outcome,
            "wrong": outcome.false,
            "subject": one_line(edge.subject),
            "subject_number": self.number(edge.subject),
            "permission": one_line(edge.permission),
            "object": self._object(edge.domain_object),
            "audit": one.audit,
            "policy": self._label(one.policy),
            "transports": [self._label(label, one.policy) for label in one.transports],
        }

    def _label(self, label: Label | None, policy: Label | None = None) -> Mapping[str, Any] | None:
        if label is None:
            return None
        links = []
        for place in (label.where, *label.where.chain) if label.where else ():
            at = self._sources.get(place.file)
            target = "" if at is None else f"f{at}-{place.line}" if place.line else f"f{at}"  # without the file: empty
            links.append({"text": one_line(citation(place.file, place.line, place.source)), "target": target})
        return {
            "allowed": label.allowed,
            "wrong": policy is not None and label.allowed != policy.allowed,
            "reason": one_line(label.reason),
            "links": links,
        }

    def _object(self, key: DomainObject) -> Mapping[str, Any]:
        domain, object_ = key
        return {
            "number": self.number(key),
            "name": object_name(object_, domain),
            "kind": KINDS[object_.kind],
            "kind_class": object_.kind,
            "pattern": object_ in self._labelled.patterns,
            "probe": object_ in self._labelled.probes,
        }

    def object_rows(self) -> list[Mapping[str, Any]]:
        """Return every object with the permissions that subjects have on it."""
        rows: dict[DomainObject, dict[str, Any]] = {
            key: {**self._object(key), "allowed": [], "denied": 0, "wrong": 0} for key in self.objects
        }
        for one in self._labelled.edges:
            row, outcome, subject = rows[one.edge.domain_object], one.outcome(), one.edge.subject
            row["denied"] += outcome is EdgeOutcome.DENY
            row["wrong"] += outcome.false
            if outcome not in {EdgeOutcome.DENY, EdgeOutcome.FALSE_NEGATIVE}:
                row["allowed"].append((self.number(subject), one_line(subject), one_line(one.edge.permission)))
        return [*rows.values()]
