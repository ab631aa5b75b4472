# SPDX-License-Identifier: Apache-2.0
"""Write the web page and the pictures of ``keymint verify --report``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from comarmor.errors import Origin
from comarmor.regex import lazy_regex
from keymint.api.graph import MISMATCHES, Edge
from keymint.command_line.named_files import exists, read_input, write_outputs
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph, policy_label, select_edges
from keymint.drawing.simplify import DrawingOptions
from keymint.run.run import Run
from keymint.verify.mismatch import Mismatch
from keymint.verify.verification import Verification

PAGE = "index.html"
MOST_TRUE = 10_000
"""Edges without a mismatch to draw, of allowed edges and again of edges that no rule allows; counts include all.

Edges that a rule denies are all drawn."""

_UNSAFE = lazy_regex(r"[^A-Za-z0-9._-]+")


def labelled_edges(
    title: str,
    verified: Verification,
    typed: Callable[[str], str],
    common: Callable[[Origin], bool] = lambda _: False,
) -> LabelledGraph:
    """Return the graph with the labels of policy and transports.

    An edge without a mismatch has the label of the policy. After the last mismatch that was kept, labels of a transport
    with omitted mismatches are unknown.

    Args:
        title: one line.
        verified: the comparison of each transport of a build type, with all edges in the order of the mismatches.
        typed: returns a path as the user would type it.
        common: returns whether the rule at a place is one that every node includes.
    """
    outcomes, decide = verified.comparisons, verified.decide  # decide only edges that are drawn
    findings = [{finding.edge: finding for finding in outcome.findings} for outcome in outcomes]
    last = [outcome.findings[-1].edge if outcome.omitted and outcome.findings else None for outcome in outcomes]
    known = [not outcome.omitted or bool(outcome.findings) for outcome in outcomes]

    def labels() -> Iterator[LabelledEdge]:
        room = {True: MOST_TRUE, False: MOST_TRUE}
        for edge, may in _with_endpoints(zip(verified.edges(), verified.labels, strict=True), findings):
            mismatches = [each.get(edge) for each in findings]
            decision = decide(edge) if any(mismatches) or room[bool(may)] or not may else None
            express = decision is not None and not decision.allowed and decision.where is not None
            if decision is not None and (any(mismatches) or express or room[bool(may)]):
                room[bool(may)] -= not any(mismatches) and not express
                policy = policy_label(decision, typed)
                transport_labels = tuple(
                    _of_finding(mismatch, typed) if mismatch else Label(policy.allowed) if known[at] else None
                    for at, mismatch in enumerate(mismatches)
                )
                shared = decision.allowed and decision.where is not None and common(decision.where)
                yield LabelledEdge(edge, policy, transport_labels, decision.audit, shared)
            for at, end in enumerate(last):
                known[at] = known[at] and edge != end

    confusions = [outcome.confusion for outcome in outcomes]
    names = [outcome.transport for outcome in outcomes]
    return LabelledGraph.of(title, labels(), transports=names, confusions=confusions)


def _with_endpoints(
    edges: Iterable[tuple[Edge, int]], findings: Sequence[Mapping[Edge, Mismatch]]
) -> Iterator[tuple[Edge, int]]:
    """Yield edges with their labels, then mismatches on endpoints, which are not edges of the graph."""
    left = dict.fromkeys(edge for each in findings for edge in each)
    for edge, may in edges:
        left.pop(edge, None)
        yield edge, may
    yield from ((edge, 0) for edge in left)


def _of_finding(finding: Mismatch, typed: Callable[[str], str]) -> Label:
    verdict = finding.verdict
    reason = "; ".join(filter(None, (finding.reason, verdict.deviation)))
    return Label(verdict.allowed, reason, finding.document.with_files(typed))


def write_report(run: Run, folder: Path, labelled: LabelledGraph) -> list[str]:
    """Write the page and the pictures of a labelled graph into a directory.

    Returns:
        The written files, as the user would type them.

    Raises:
        KeymintError: a file cannot be replaced.
    """
    # Templates are slow to import.
    from keymint.drawing.html_report import html_report  # noqa: PLC0415
    from keymint.drawing.svg import svg  # noqa: PLC0415

    pictures = {"graph.svg": svg(labelled)}
    for at, name in enumerate(labelled.transports):
        pictures[f"graph-{_UNSAFE.sub('_', name)}.svg"] = svg(labelled, DrawingOptions(transport=at))
    # Written even without mismatches, to replace the picture of an earlier run.
    pictures["differences.svg"] = svg(select_edges(labelled, only=MISMATCHES))
    return write_outputs(run, folder / PAGE, html_report(labelled, sources(run, labelled)), pictures)


def sources(run: Run, labelled: LabelledGraph) -> Mapping[str, bytes]:
    """Return the content of the files that a graph refers to, by name."""
    places = {
        label.where
        for edge in labelled.edges
        for label in (edge.policy, *edge.transports)
        if label is not None and label.where
    }
    files = sorted({each.file for place in places for each in (place, *place.chain)})
    return {file: read_input(run, Path(file)) for file in files if exists(run, Path(file))}
