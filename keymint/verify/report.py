"""What came of a comparison, as diagnostics for people and as JSON for machines (``docs/json.md``)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import Verdict
from keymint.graph import ConfusionMatrix, Edge, EdgeOutcome
from keymint.verify.mismatch import Comparison, Mismatch
from keymint.verify.words import in_words, request

_EXAMPLES = 3


def remedy(finding: Mismatch) -> str:
    """Return how to mend what a finding is about."""
    name = finding.edge.subject.removeprefix("/")
    much = "more" if finding.error is EdgeOutcome.FALSE_POSITIVE else "less"
    return (
        f"the enclave permits {much} than the policy; to make it anew: "
        f"keymint create {name}; keymint build -f {name}; keymint install {name}"
    )


def messages(outcomes: Sequence[Comparison]) -> Iterator[Diagnostic]:
    """Yield a diagnostic for each cause: what the same rules explain, on whatever transports, is told together."""
    merged: dict[tuple[object, ...], tuple[list[str], list[Mismatch]]] = {}
    for outcome in outcomes:
        for cause, together in _by_cause(outcome.findings).items():
            edges = tuple(finding.edge for finding in together)
            merged.setdefault((cause, edges), ([], together))[0].append(outcome.transport)
    for transports, together in merged.values():
        first, *others = together
        some = [f"{each.edge.permission} {each.edge.object.name}" for each in others[:_EXAMPLES]]
        also = f"; likewise {len(others)} more: {', '.join(some)}{' …' if len(others) > len(some) else ''}"
        yield Diagnostic(
            str(first.error),
            Severity.ERROR,
            in_words(transports, first, here=True) + (also if others else ""),
            first.policy.where or first.document,
            remedy(first),
            first.edge.subject,
        )
    for outcome in outcomes:
        if outcome.omitted:
            yield Diagnostic(
                "findings-omitted",
                Severity.WARNING,
                f"{outcome.omitted} more findings on {outcome.transport} are counted and not listed",
                None,
                "raise --limit, or verify some packages at a time",
            )


def _by_cause(findings: Sequence[Mismatch]) -> dict[tuple[object, ...], list[Mismatch]]:
    """Group findings; a reason that names no object, a grant that has expired, say, is one cause for all objects."""
    causes: dict[tuple[object, ...], list[Mismatch]] = {}
    for finding in findings:
        edge = finding.edge
        if edge.object.name in finding.reason:
            cause = (finding.policy.where, finding.document.line, finding.verdict.deviation)
        else:
            cause = (None, finding.document.line, finding.reason)
        causes.setdefault((edge.subject, finding.error, *cause), []).append(finding)
    return causes


def as_result(
    outcomes: Sequence[Comparison], subjects: Sequence[str], edges: int, typed: Callable[[str], str]
) -> dict[str, Any]:
    """Return the outcome of ``keymint verify`` as what JSON can hold.

    Args:
        outcomes: what came of each transport.
        subjects: the subjects that were verified.
        edges: how many edges each transport was asked for.
        typed: returns a path as the user would type it.
    """
    return {
        "subjects": list(subjects),
        "edges": edges,
        "transports": [
            {
                "name": outcome.transport,
                "version": outcome.version,
                "tier": str(outcome.tier),
                "confusion": confusion(outcome.confusion),
                "findings": [_finding(finding, typed) for finding in outcome.findings],
                "findings_omitted": outcome.omitted,
            }
            for outcome in outcomes
        ],
    }


def confusion(counts: ConfusionMatrix) -> dict[str, int]:
    """Return counts by label, allowing being the positive."""
    return {
        "true_positive": counts.true_positive,
        "false_negative": counts.false_negative,
        "false_positive": counts.false_positive,
        "true_negative": counts.true_negative,
    }


def _finding(finding: Mismatch, typed: Callable[[str], str]) -> dict[str, Any]:
    return {
        "error": str(finding.error),
        "edge": edge_document(finding.edge),
        "request": request(finding.edge),
        "policy": {
            "allowed": finding.policy.allowed,
            "reason": finding.policy.reason,
            "rule": place(finding.policy.where, typed),
            "audit": finding.policy.audit,
        },
        "transport": transport_document(finding.verdict, finding.reason, finding.document, finding.model, typed),
    }


def edge_document(edge: Edge) -> dict[str, Any]:
    """Return an edge as what JSON can hold."""
    return {
        "subject": edge.subject,
        "permission": edge.permission,
        "kind": edge.object.kind,
        "object": edge.object.name,
        "partitions": list(edge.object.partitions),
        "domain": edge.domain,
    }


def transport_document(
    verdict: Verdict, reason: str, document: Origin | None, model: str, typed: Callable[[str], str]
) -> dict[str, Any]:
    """Return what a transport decides as what JSON can hold.

    Args:
        verdict: what it decides, and says itself.
        reason: why it does.
        document: the rule in the enclave's document that decides.
        model: the simulated transport that explains it, or empty.
        typed: returns a path as the user would type it.
    """
    return {
        "allowed": verdict.allowed,
        "reason": reason,
        "said": verdict.reason,
        "rule": place(document, typed),
        "deviation": verdict.deviation or None,
        "explained_by": model or None,
    }


def place(where: Origin | None, typed: Callable[[str], str]) -> Mapping[str, Any] | None:
    """Return a place as what JSON can hold."""
    if where is None:
        return None
    return {
        "file": typed(where.file),
        "line": where.line or None,
        "included_from": [{"file": typed(outer.file), "line": outer.line} for outer in where.chain],
    }
