# SPDX-License-Identifier: Apache-2.0
"""``keymint verify``: report mismatches between policy and transports."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path

import click

from comarmor.errors import Diagnostic, Severity
from comarmor.text import counted
from keymint.api import Tier, Transport
from keymint.api.graph import Graph
from keymint.api.graph_json import load
from keymint.command_line.named_files import read_input, write_outputs
from keymint.command_line.named_policies import workspace_library_rules
from keymint.command_line.options import FILE, PATH, packages_argument, transport_option, vendors_of_option
from keymint.command_line.verb import verb
from keymint.command_line.verify_report import labelled_edges, write_report
from keymint.life.workspace_register import with_enclaves
from keymint.output.json import comparisons_json
from keymint.output.junit import junit as junit_document
from keymint.output.mismatches import SARIF_RULES, diagnostics, enumeration, junit_suites, sarif_results
from keymint.output.report import Report, findings_if
from keymint.output.sarif import sarif as sarif_log
from keymint.run.run import Run
from keymint.stages.proof.trust_anchors import differences
from keymint.store.changes import Action, Step
from keymint.verify.compare import Asking
from keymint.verify.copies import enclave_copies
from keymint.verify.mismatch import EdgeComparison, Tally
from keymint.verify.scope import (
    VerificationScope,
    installed_scopes,
    selective,
    subjects_of_graph,
)
from keymint.verify.transports import choose
from keymint.verify.verification import Verification, verified_in_parts
from keymint.workspace.policy_loading import load_policy


@verb(executor=True)
@packages_argument
@click.option(
    "-g",
    "--graph",
    type=PATH,
    metavar="FILE",
    help="Ask for every subject, permission and object of this graph (docs/graph.md) [the objects of the policy, and "
    "names that probe its patterns].",
)
@transport_option
@vendors_of_option
@click.option(
    "--tier",
    type=click.Choice([str(tier) for tier in Tier]),
    default=str(Tier.DECISION),
    show_default=True,
    help="What to test: access-control code, endpoint creation, or data exchange.",
)
@click.option(
    "--ros",
    is_flag=True,
    help="Ask the ROS 2 that is sourced: a stand-in node for each enclave tries each right and each near miss, in a "
    "network of its own that has nothing but loopback.",
)
@click.option(
    "--limit", type=click.IntRange(0), default=1000, show_default=True, help="Mismatches to list per transport."
)
@click.option("--sarif", type=FILE, metavar="FILE", help="Write the mismatches as SARIF 2.1.0.")
@click.option("--junit", type=FILE, metavar="FILE", help="Write the results as JUnit XML.")
@click.option(
    "--report",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write an offline web page, and pictures of the labelled graph.",
)
def verify(
    run: Run,
    names: tuple[str, ...],
    graph: Path | None,
    chosen: tuple[str, ...],
    distro: str | None,
    tier: str,
    ros: bool,
    limit: int,
    sarif: Path | None,
    junit: Path | None,
    report: Path | None,
) -> Report:
    """Compare the decisions of transports on installed enclaves with the policy, edge by edge.

    \b
    false positive: a transport allows what the policy denies
    false negative: a transport denies what the policy allows

    Each mismatch is shown with the rule of the policy and the rule of the document. NAME is a package [all].
    docs/verification.md says in one table what each verb reads.

    Exit code 3: there are mismatches, or an enclave does not trust the workspace's authorities.
    """
    session = run.session().for_vendors_of(distro)
    if ros:
        chosen, tier = (*chosen, "ros"), tier if tier == Tier.EXCHANGE else str(Tier.ADMISSION)
    tally = Tally() if ros else None
    chosen_names = with_enclaves(session, run.names(session, names), names)
    there = installed_scopes(session, chosen_names)
    # A transport trusts the authorities in the enclave; they must be the workspace's.
    foreign = differences(session, chosen_names)
    policy = load_policy(session)
    groups = choose(run.plugins, chosen, Tier(tier), tuple(there.scopes), session.vendors_of or session.profile.distro)
    scopes = {name: selective(there.scopes[name], group.values()) for name, group in groups.items()}
    transports = [transport for group in groups.values() for transport in group.values()]
    system = None if graph is None else subjects_of_graph(
        load(read_input(run, graph), str(graph)), there.enclaves, only=bool(names)
    )  # fmt: skip
    with enclave_copies(
        session.tree, session.workspace.install, there.enclaves, transports, there.others, there.infrastructure
    ) as copies:
        total = sum((1 + len(group)) * len(there.scopes[name].enclaves) for name, group in groups.items())
        with run.console.progress(total, run.setting.monotonic) as advance:
            asking = Asking(
                Tier(tier), limit, lambda name, subject: advance(Step(name, subject, Action.UNCHANGED)), tally
            )
            with run.pool() as pool:
                verified = [
                    verified_in_parts(pool, run.plugins, scopes[name], policy, system, copies, group, asking)
                    for name, group in groups.items()
                ]
        subjects = tuple(sorted({subject for each in verified for subject in each.subjects}))
        outcomes = [outcome for each in verified for outcome in each.comparisons]
        edges = sum(len(each.labels) for each in verified)
        _show(run, outcomes, len(subjects), edges)
        if tally is not None:
            tally.texts = Counter({copies.back(text): count for text, count in tally.texts.items()})
            rows = [[each, *map(str, row)] for each, row in sorted(tally.rows.items())]
            run.console.table(["OPERATION", "ASKED", "AGREED", "DENIED"], rows)
            run.console.table(["TIMES", "ROS SAID"], [[str(each), text] for text, each in tally.texts.most_common()])
        _write(run, verified, sarif, junit)
        if report is not None:
            for each in verified:
                title = f"{graph.stem if graph else session.profile.name} on {', '.join(groups[each.build_type])}"
                folder = report / run.plugins.build_type(each.build_type).TRANSPORT if len(verified) > 1 else report
                labelled = labelled_edges(title, each, run.typed, workspace_library_rules(session))
                run.console.lines(f"{file} written" for file in write_report(run, folder, labelled))
    wrong = any(outcome.confusion.errors for outcome in outcomes)
    return run.report(
        comparisons_json(outcomes, subjects, edges, run.typed) | ({} if tally is None else tally.json()),
        (*foreign, *_unasked(there.scopes, groups, system, Tier(tier), chosen), *diagnostics(outcomes)),
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
            message = f"{counted(len(edges), 'edge')} of the graph not asked of {enumeration(tuple(groups[name]))}"
            first = edges[0].object
            reason = f"{name} has no name for the {first.kind} {first.name!r}"
            more = len({edge.object for edge in edges}) - 1
            reason += f", and for {counted(more, 'more object')}" if more else ""
            yield Diagnostic.note("edges-unasked", f"{message}: {reason}")


def _show(run: Run, outcomes: Sequence[EdgeComparison], subjects: int, edges: int) -> None:
    """Show the confusion table."""
    columns = ["TRANSPORT", "VERSION", "TRUE POSITIVE", "FALSE NEGATIVE", "FALSE POSITIVE", "TRUE NEGATIVE"]
    rows = [[outcome.transport, outcome.version or "-", *map(str, astuple(outcome.confusion))] for outcome in outcomes]
    run.console.table(columns, rows)
    wrong = sum(outcome.confusion.errors for outcome in outcomes)
    run.console.line(
        f"verified {counted(subjects, 'enclave')}, {counted(edges, 'edge')} on "
        f"{counted(len(outcomes), 'transport')}: {counted(wrong, 'mismatch')} between policy and transports"
    )


def _write(run: Run, verified: Sequence[Verification], sarif: Path | None, junit: Path | None) -> None:
    """Write the requested reports."""
    outcomes = [(outcome, each.subjects) for each in verified for outcome in each.comparisons]
    results = [outcome for outcome, _ in outcomes]
    if sarif is not None:
        log = sarif_log("keymint verify", SARIF_RULES, sarif_results(results), run.typed, Severity.ERROR)
        write_outputs(run, sarif, log)
    if junit is not None:
        write_outputs(run, junit, junit_document("keymint verify", junit_suites(outcomes)))
