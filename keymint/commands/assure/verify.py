# SPDX-License-Identifier: Apache-2.0
"""``keymint verify``: report mismatches between policy and transports."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from comarmor.text import lazy_regex, quantity
from comarmor.values import replace
from keymint.api import Tier, Transport
from keymint.api.graph import MISMATCHES, Edge, EdgeOutcome, Graph
from keymint.api.graph_json import load
from keymint.command_line.named_files import made_of, read_input, source_files, write_outputs
from keymint.command_line.named_policies import workspace_library_rules
from keymint.command_line.options import Names, implementation_option, names_group, vendors_of_option
from keymint.command_line.verb import FILE, Report, Run, findings_if, flag, option, path_option, verb
from keymint.drawing.captions import left_out_json
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph, policy_label, select_edges
from keymint.drawing.simplify import DrawingOptions
from keymint.errors import Diagnostic, Origin, Severity
from keymint.life.workspace_register import with_enclaves
from keymint.output.junit import junit as junit_document
from keymint.output.mismatches import comparisons_json, diagnostics, enumeration, junit_suites, sarif_results
from keymint.output.sarif import sarif as sarif_log
from keymint.stages.trust_anchors import differences
from keymint.store.changes import Action, Step
from keymint.verify.compare import Asking, Mismatch, Tally
from keymint.verify.copies import enclave_copies
from keymint.verify.scope import VerificationScope, installed_scopes, made_up_objects, selective, subjects_of_graph
from keymint.verify.transports import choose
from keymint.verify.verification import Verification, VerificationPart, verified_in_parts
from keymint.workspace.policy_loading import load_policy

_PAGE = "index.html"
MOST_TRUE = 10_000
"""Edges without a mismatch to draw, of allowed edges and again of edges that no rule allows; counts include all.

Edges that a rule denies are all drawn."""

_UNSAFE = lazy_regex(r"[^A-Za-z0-9._-]+")


@verb(processes=True, former={"chosen": "-t --transport"})
def verify(
    run: Run,
    names: Names = names_group(),
    graph: Path | None = path_option("-g"),
    chosen: tuple[str, ...] = implementation_option,
    distro: str | None = vendors_of_option,
    tier: str = option(type=click.Choice([str(tier) for tier in Tier]), default=str(Tier.DECISION), show_default=True),
    ros: bool = flag(),
    limit: int = option(type=click.IntRange(0), metavar="N", default=1000, show_default=True),
    sarif: Path | None = path_option(kind=FILE),
    junit: Path | None = path_option(kind=FILE),
    report: Path | None = option(type=click.Path(path_type=Path, file_okay=False), metavar="DIR"),
) -> Report:
    """Ask each implementation of a transport what it permits, and compare every answer with the policy.

    \b
    false positive: a transport allows what the policy denies
    false negative: a transport denies what the policy allows

    Each mismatch is shown with the rule of the policy and the rule of the document. NAME is a package [all].
    docs/verification.md says in one table what each verb reads.

    Exit code 3: there are mismatches, or an enclave does not trust the workspace's authorities.

    Options:
        graph: Ask for every subject, permission and object of this graph (docs/graph.md) [the objects of the policy,
            and names that probe its patterns].
        tier: What to test: access-control code, endpoint creation, or data exchange.
        ros: Ask the ROS 2 that is sourced: a stand-in node for each enclave tries each right and each near miss, in a
            network namespace with only loopback.
        limit: Mismatches to list per implementation.
        sarif: Write the mismatches as SARIF 2.1.0.
        junit: Write the results as JUnit XML.
        report: Write an offline web page, and pictures of the labelled graph.
    """
    session = run.session().for_vendors_of(distro)
    if ros:
        chosen, tier = (*chosen, "ros"), tier if tier == Tier.EXCHANGE else str(Tier.ADMISSION)
    tally = Tally() if ros else None
    chosen_names = with_enclaves(session, names.packages(run, session), named=bool(names))
    installed, enclaves, others, infrastructure = installed_scopes(session, chosen_names)
    # A transport trusts the authorities in the enclave; they must be the workspace's.
    foreign = differences(session, chosen_names)
    policy = load_policy(session)
    groups = choose(run.plugins, chosen, Tier(tier), tuple(installed), session.vendors_of or session.profile.distro)
    scopes = {name: selective(installed[name], group.values()) for name, group in groups.items()}
    transports = [transport for group in groups.values() for transport in group.values()]
    system = None if graph is None else subjects_of_graph(
        load(read_input(run, graph), str(graph)), enclaves, only=bool(names)
    )  # fmt: skip
    install = session.workspace.install
    with enclave_copies(session.tree, install, enclaves, transports, others, infrastructure) as copies:
        total = sum((1 + len(group)) * len(installed[name].enclaves) for name, group in groups.items())
        with run.console.progress(total, run.setting.monotonic) as advance:
            asking = Asking(
                Tier(tier), limit, lambda name, subject: advance(Step(name, subject, Action.UNCHANGED)), tally
            )
            parts = {name: VerificationPart(each, policy, system, asking, copies) for name, each in scopes.items()}
            verified = [verified_in_parts(run.pool, run.plugins, parts[name], group) for name, group in groups.items()]
        subjects = tuple(sorted({subject for each in verified for subject in each.subjects}))
        outcomes = [outcome for each in verified for outcome in each.comparisons]
        edges = sum(len(each.labels) for each in verified)
        if tally is not None:
            tally.texts = Counter({copies.back(text): count for text, count in tally.texts.items()})
        result = comparisons_json(outcomes, subjects, edges, run.typed) | ({} if tally is None else tally.json())
        _show(run, result)
        _write(run, verified, sarif, junit)
        if report is not None:
            made = made_of(run, policy, session, read_input(run, graph) if graph else b"")
            for each in verified:
                title = f"{graph.stem if graph else session.profile.name} on {', '.join(groups[each.build_type])}"
                folder = report / run.plugins.build_type(each.build_type).TRANSPORT if len(verified) > 1 else report
                labelled = labelled_edges(title, each, run.typed, workspace_library_rules(session))
                asked = () if graph else (one.edge for one in labelled.edges)
                probes = frozenset(made_up_objects(policy, scopes[each.build_type], asked))
                labelled = replace(labelled, probes=probes, made=made)
                written, missing = write_report(run, folder, labelled)
                run.console.lines(f"{file} written" for file in written)
                result["left_out"] = [*result.get("left_out", ()), *missing]
    wrong = any(outcome.confusion.errors for outcome in outcomes)
    return run.report(
        result,
        (*foreign, *_unasked(installed, groups, system, Tier(tier), chosen), *diagnostics(outcomes)),
        findings_if(wrong or foreign),
        workspace=session.workspace,
    )


def _unasked(
    scopes: Mapping[str, VerificationScope],
    groups: Mapping[str, Mapping[str, Transport]],
    system: Graph | None,
    tier: Tier,
    chosen: Sequence[str],
) -> Iterator[Diagnostic]:
    """Yield a finding for each build type that no transport was asked about, and for edges that it cannot express."""
    for name, scope in scopes.items():
        if name not in groups:
            if not chosen:
                message = f"what {name} built is not verified: none of its transports supports the tier {tier} here"
                help_ = "'keymint transports' shows how to install one"
                yield Diagnostic.warning("transport-none", message, None, help_)
            continue
        edges = [edge for edge in system.edges if not scope.has_name(edge.object)] if system else ()
        if edges:
            message = f"{quantity(len(edges), 'edge')} of the graph not asked of {enumeration(tuple(groups[name]))}"
            first = edges[0].object
            reason = f"{name} has no name for the {first.kind} {first.name!r}"
            more = len({edge.object for edge in edges}) - 1
            reason += f", and for {quantity(more, 'more object')}" if more else ""
            yield Diagnostic.note("edges-unasked", f"{message}: {reason}")


def _show(run: Run, result: Mapping[str, Any]) -> None:
    """Show the confusion table, and what ROS was asked."""
    outcomes = [each | each["confusion"] for each in result["transports"]]
    cells = ("true_positive", "false_negative", "false_positive", "true_negative")
    columns = {each.replace("_", " ").upper(): each for each in cells}
    run.console.table({"TRANSPORT": "name", "VERSION": "version"} | columns, outcomes)
    wrong = sum(each["false_positive"] + each["false_negative"] for each in outcomes)
    run.console.line(
        f"verified {quantity(len(result['subjects']), 'enclave')}, {quantity(result['edges'], 'edge')} on "
        f"{quantity(len(outcomes), 'transport')}: {quantity(wrong, 'mismatch')} between policy and transports"
    )
    if "operations" in result:
        columns = {"OPERATION": "permission", "ASKED": "asked", "AGREED": "agreed", "DENIED": "denied"}
        run.console.table(columns, result["operations"])
        run.console.table({"TIMES": "count", "ROS SAID": "text"}, result["denials"])


def _write(run: Run, verified: Sequence[Verification], sarif: Path | None, junit: Path | None) -> None:
    """Write the requested reports."""
    outcomes = [(outcome, each.subjects) for each in verified for outcome in each.comparisons]
    results = [outcome for outcome, _ in outcomes]
    if sarif is not None:
        log = sarif_log("keymint verify", sarif_results(results), run.typed, Severity.ERROR)
        write_outputs(run, sarif, log)
    if junit is not None:
        write_outputs(run, junit, junit_document("keymint verify", junit_suites(outcomes)))


def labelled_edges(
    title: str, verified: Verification, typed: Callable[[str], str], common: Callable[[Origin], bool] = lambda _: False
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

    omitted: Counter[tuple[EdgeOutcome, str]] = Counter()

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
            else:
                omitted[EdgeOutcome.ALLOW if may else EdgeOutcome.DENY, edge.object.kind] += 1
            for at, end in enumerate(last):
                known[at] = known[at] and edge != end

    confusions = [outcome.confusion for outcome in outcomes]
    names = [outcome.transport for outcome in outcomes]
    labelled = LabelledGraph.of(title, labels(), transports=names, confusions=confusions)
    total = len(labelled.edges) + omitted.total()
    return replace(labelled, omitted=omitted, endpoints=total - len(verified.labels))


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


def write_report(run: Run, folder: Path, labelled: LabelledGraph) -> tuple[list[str], list[dict[str, object]]]:
    """Write the page and the pictures of a labelled graph into a directory.

    Returns:
        The written files, as the user would type them, and how many edges of which kind the page does not list.

    Raises:
        KeymintError: a file cannot be replaced.
    """
    # Templates are slow to import.
    from keymint.drawing.html_report import html_report, listed_edges  # noqa: PLC0415
    from keymint.drawing.svg import svg  # noqa: PLC0415

    # Probes make very many denials that no rule has; the page lists them.
    options = DrawingOptions(denials=False)
    pictures = {"graph.svg": svg(labelled, options)}
    for at, name in enumerate(labelled.transports):
        pictures[f"graph-{_UNSAFE.sub('_', name)}.svg"] = svg(labelled, replace(options, transport=at))
    # Written even without mismatches, to replace the picture of an earlier run.
    pictures["differences.svg"] = svg(select_edges(labelled, only=MISMATCHES))
    page = html_report(labelled, source_files(run, labelled), options)
    return write_outputs(run, folder / _PAGE, page, pictures), left_out_json(labelled.left_out(listed_edges(labelled)))
