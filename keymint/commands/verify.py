# SPDX-License-Identifier: Apache-2.0
"""``keymint verify``: report mismatches between policy and transports."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import click

from comarmor.errors import Severity
from comarmor.text import counted
from keymint.api import Tier
from keymint.changes import Action, Step
from keymint.commands.options import FILE, PATH, complete_package, transport_option
from keymint.commands.policies import workspace_library_rules
from keymint.commands.run import Run
from keymint.commands.user_files import read_input, write_outputs
from keymint.commands.verb import verb
from keymint.commands.verify_report import labelled_edges, write_report
from keymint.errors import ExitCode
from keymint.graph_json import load
from keymint.output.json import comparisons_json
from keymint.output.junit import junit as junit_document
from keymint.output.mismatches import SARIF_RULES, diagnostics, junit_suites, sarif_results
from keymint.output.report import Report
from keymint.output.sarif import sarif as sarif_log
from keymint.plan.enclaves import installed
from keymint.plan.policy import load_policy
from keymint.plan.trust_anchors import differences
from keymint.verify.compare import compare
from keymint.verify.copies import copied
from keymint.verify.endpoint_policy import EndpointPolicy, label
from keymint.verify.explain import Explainer
from keymint.verify.halves import with_halves
from keymint.verify.mismatch import Comparison
from keymint.verify.scope import edges_of_graph, edges_of_policy, verification_scope
from keymint.verify.usable_transports import choose, models


@verb()
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete_package)
@click.option(
    "-g",
    "--graph",
    type=PATH,
    metavar="FILE",
    help="Ask for every subject, permission and object of this graph (docs/graph.md) [the objects of the policy, and "
    "names that probe its patterns].",
)
@transport_option
@click.option(
    "--tier",
    type=click.Choice([str(tier) for tier in Tier]),
    default=str(Tier.DECISION),
    show_default=True,
    help="What to test: access-control code, endpoint creation, or data exchange.",
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
    tier: str,
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

    Exit code 3: there are mismatches, or an enclave does not trust the workspace's authorities.
    """
    workspace = run.workspace()
    inputs = run.snapshot(workspace)
    session = inputs.session()
    chosen_names = run.names(inputs, names)
    scope = verification_scope(session, chosen_names)
    # A transport trusts the authorities in the enclave; they must be the workspace's.
    foreign = differences(session, chosen_names)
    policy = load_policy(session)
    subjects = tuple(scope.enclaves)
    transports = choose(run.plugins, chosen, Tier(tier))
    others = [session.enclaves / name for name in installed(session)]
    with copied(inputs.tree, workspace.install, scope.enclaves, transports.values(), others) as copies:
        transports = copies.read_by(transports)
        if graph is None:
            edges = edges_of_policy(policy, replace(scope, enclaves=copies.enclaves))
        else:
            subjects, edges = edges_of_graph(load(read_input(run, graph), str(graph)), scope, only=bool(names))
        endpoint_policy = EndpointPolicy(policy, scope.namings)
        explain = Explainer(endpoint_policy, transports, lambda: copies.read_by(models(run.plugins)))
        outcomes: list[Comparison] = []
        with run.console.progress((1 + len(transports)) * len(subjects), run.setting.monotonic) as advance:
            labels = label(endpoint_policy, edges(), _advancing(advance, "policy"))
            for name, transport in transports.items():
                on_subject = _advancing(advance, name)
                outcome = compare(
                    name, transport, scope.enclaves, edges(), labels, Tier(tier), explain, limit, on_subject
                )
                outcomes.append(
                    with_halves(
                        outcome,
                        transport,
                        scope.enclaves,
                        edges(),
                        labels,
                        endpoint_policy,
                        scope.namings,
                        explain,
                        limit,
                    )
                )
        _show(run, outcomes, len(subjects), len(labels))
        _write(run, outcomes, subjects, sarif, junit)
        if report is not None:
            title = f"{graph.stem if graph else session.profile.name} on {', '.join(transports)}"
            common = workspace_library_rules(session)
            labelled = labelled_edges(title, outcomes, edges(), labels, endpoint_policy.decide, run.typed, common)
            for file in write_report(run, report, labelled):
                run.console.line(f"{file} written")
    wrong = any(outcome.confusion.errors for outcome in outcomes)
    return Report(
        run.verb,
        workspace,
        (),
        (*foreign, *diagnostics(outcomes)),
        comparisons_json(outcomes, subjects, len(labels), run.typed),
        ExitCode.FINDINGS if wrong or foreign else ExitCode.DONE,
    )


def _advancing(advance: Callable[[Step], None], transport: str) -> Callable[[str], None]:
    return lambda subject: advance(Step(transport, subject, Action.UNCHANGED))


def _show(run: Run, outcomes: Sequence[Comparison], subjects: int, edges: int) -> None:
    """Show the confusion table."""
    columns = ["TRANSPORT", "VERSION", "TRUE POSITIVE", "FALSE NEGATIVE", "FALSE POSITIVE", "TRUE NEGATIVE"]
    rows = [
        [
            outcome.transport,
            outcome.version or "-",
            str(outcome.confusion.true_positive),
            str(outcome.confusion.false_negative),
            str(outcome.confusion.false_positive),
            str(outcome.confusion.true_negative),
        ]
        for outcome in outcomes
    ]
    run.console.table(columns, rows)
    wrong = sum(outcome.confusion.errors for outcome in outcomes)
    run.console.line(
        f"verified {counted(subjects, 'enclave')}, {counted(edges, 'edge')} on "
        f"{counted(len(outcomes), 'transport')}: {counted(wrong, 'mismatch')} between policy and transports"
    )


def _write(
    run: Run, outcomes: Sequence[Comparison], subjects: Sequence[str], sarif: Path | None, junit: Path | None
) -> None:
    """Write the requested reports."""
    documents: Mapping[Path | None, Callable[[], bytes]] = {
        sarif: lambda: sarif_log("keymint verify", SARIF_RULES, sarif_results(outcomes), run.typed, Severity.ERROR),
        junit: lambda: junit_document("keymint verify", junit_suites(outcomes, subjects)),
    }
    for path, document in documents.items():
        if path is not None:
            write_outputs(run, path, document())
