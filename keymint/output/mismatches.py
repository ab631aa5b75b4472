# SPDX-License-Identifier: Apache-2.0
"""Requests, rules and mismatches between policy and transports: in words, as diagnostics, and for other formats.

These are SARIF, JUnit, and the JSON of ``keymint verify``, which ``docs/json.md`` describes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

from comarmor.text import quantity
from keymint.api.graph import Edge, EdgeOutcome
from keymint.errors import Diagnostic, citation
from keymint.ir import Rule
from keymint.names import name_of
from keymint.output.json import Typed, decision_json, edge_json, verdict_json
from keymint.output.junit import JUnitCase
from keymint.output.sarif import SarifResult
from keymint.verify.compare import EdgeComparison, Mismatch

_MOST_EXPRESSIONS = 4
_EXAMPLES = 3


# -- in words --------------------------------------------------------------------------------------------------------


def request_text(edge: Edge) -> str:
    """Return an edge in the notation of the command line: ``/talker ros_publish /chatter``."""
    text = f"{edge.subject} {edge.permission} {edge.object.name}"
    return text + "".join(f" in partition {name!r}" for name in edge.object.partitions)


def mismatch_text(transports: Sequence[str], mismatch: Mismatch, *, at_rule: bool = False) -> str:
    """Return a mismatch on one line: the edge, both labels, and the reason of each.

    Args:
        transports: names of the transports with this mismatch.
        mismatch: the mismatch.
        at_rule: the line is shown at the policy's rule, if there is one.
    """
    policy, verdict = mismatch.policy, mismatch.verdict
    by_policy = "by this rule" if at_rule and policy.where else str(policy.reason)
    return (
        f"{mismatch.error}: {request_text(mismatch.edge)}: the policy {verb_of(policy.allowed)} it ({by_policy}), "
        f"but {enumeration(transports)} {verb_of(verdict.allowed, many=len(transports) > 1)} it "
        f"({document_reason(mismatch)})"
    )


def document_reason(mismatch: Mismatch, typed: Typed = str) -> str:
    """Return the place in the enclave's document, the transport's reason, and the deviation that explains it."""
    place, deviation = citation(typed(mismatch.document.file), mismatch.document.line), mismatch.verdict.deviation
    deviates = f"; deviates from the standard: {deviation}" if deviation else ""
    return f"{place}: {mismatch.reason or 'no reason is given'}{deviates}"


def verb_of(allowed: bool, *, many: bool = False) -> str:
    """Return the verb of a decision."""
    return ("allow" if allowed else "deny") if many else ("allows" if allowed else "denies")


def enumeration(names: Sequence[str]) -> str:
    """Return names as in a sentence: ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def rule_text(rule: Rule) -> str:
    """Return a rule on one line: ``ALLOW ros_topic ros_publish of '/a', '/b' and 3 more``."""
    names = [repr(each) for each in rule.expressions[:_MOST_EXPRESSIONS]]
    more = len(rule.expressions) - len(names)
    partitions = f" in partitions {', '.join(map(repr, rule.partitions))}" if rule.partitions else ""
    audit = " (AUDIT)" if rule.audit else ""
    shown = ", ".join(names) + (f" and {more} more" if more else "")
    return f"{rule.effect} {rule.kind} {'+'.join(rule.permissions)} of {shown}{partitions}{audit}"


# -- as diagnostics --------------------------------------------------------------------------------------------------


def mismatch_finding(transports: Sequence[str], mismatches: Sequence[Mismatch]) -> Diagnostic:
    """Return the diagnostic on mismatches that have one cause for some transports."""
    first, *others = mismatches
    some = [f"{each.edge.permission} {each.edge.object.name}" for each in others[:_EXAMPLES]]
    also = f"; also {len(others)} more: {', '.join(some)}{' …' if len(others) > len(some) else ''}"
    name = name_of(first.edge.subject)
    much = "more" if first.error is EdgeOutcome.FALSE_POSITIVE else "less"
    rebuild = f"keymint create {name}; keymint build -f {name}; keymint install {name}"
    message = mismatch_text(transports, first, at_rule=True) + (also if others else "")
    help_ = f"the enclave permits {much} than the policy; rebuild it: {rebuild}"
    return Diagnostic.error(str(first.error), message, first.policy.where or first.document, help_, first.edge.subject)


def diagnostics(comparisons: Sequence[EdgeComparison]) -> Iterator[Diagnostic]:
    """Yield one diagnostic for each cause: for all edges and transports that the same rules explain."""
    merged: dict[tuple[object, ...], tuple[list[str], list[Mismatch]]] = {}
    for comparison in comparisons:
        for cause, mismatches in _by_cause(comparison.findings).items():
            edges = tuple(mismatch.edge for mismatch in mismatches)
            merged.setdefault((cause, edges), ([], mismatches))[0].append(comparison.transport)
    for transports, mismatches in merged.values():
        yield mismatch_finding(transports, mismatches)
    for comparison in comparisons:
        if comparison.omitted:
            message = f"{quantity(comparison.omitted, 'more mismatch')} on {comparison.transport} not listed"
            help_ = "raise --limit, or verify fewer packages at a time"
            yield Diagnostic.warning("findings-omitted", message, None, help_)


def _by_cause(mismatches: Sequence[Mismatch]) -> dict[tuple[object, ...], list[Mismatch]]:
    """Group mismatches by cause; a reason that names no object, e.g. an expired grant, is one cause for all objects."""
    causes: dict[tuple[object, ...], list[Mismatch]] = {}
    for mismatch in mismatches:
        edge = mismatch.edge
        if edge.object.name in mismatch.reason:
            cause = (mismatch.policy.where, mismatch.document, mismatch.verdict.deviation)
        else:
            cause = (None, mismatch.document, mismatch.reason)
        causes.setdefault((edge.subject, mismatch.error, *cause), []).append(mismatch)
    return causes


# -- for SARIF and JUnit ---------------------------------------------------------------------------------------------


def sarif_results(comparisons: Sequence[EdgeComparison]) -> list[SarifResult]:
    """Return a result for each mismatch: its place is the policy's rule, the document's rule is related."""
    return [
        SarifResult(
            Diagnostic.error(
                str(mismatch.error),
                mismatch_text([comparison.transport], mismatch),
                mismatch.policy.where or mismatch.document,
            ),
            [(mismatch.document, mismatch.reason or "the enclave's document")],
            {"keymintEdge/v1": f"{comparison.transport}|{request_text(mismatch.edge)}|{mismatch.edge.domain}"},
        )
        for comparison in comparisons
        for mismatch in comparison.findings
    ]


def junit_suites(comparisons: Iterable[tuple[EdgeComparison, Sequence[str]]]) -> dict[str, list[JUnitCase]]:
    """Return a test suite for each transport, with a test case for each subject that lists its mismatches.

    Args:
        comparisons: the comparison of each transport, with the subjects that it was asked about.
    """
    suites: dict[str, list[JUnitCase]] = {}
    for comparison, subjects in comparisons:
        cases = suites[f"{comparison.transport} ({comparison.tier})"] = []
        for subject in subjects:
            failure, details = None, ""
            if count := comparison.wrong.get(subject, 0):
                failure = "verify", f"{quantity(count, 'mismatch')} between policy and transport"
                listed = [each for each in comparison.findings if each.edge.subject == subject]
                lines = [mismatch_text([comparison.transport], each) for each in listed]
                details = "\n".join(lines) or "not listed: there are too many mismatches"
            cases.append(JUnitCase(f"keymint.{comparison.transport}", subject, failure, details))
    return suites


# -- as JSON -----------------------------------------------------------------------------------------------------------


def comparisons_json(
    comparisons: Sequence[EdgeComparison], subjects: Sequence[str], edges: int, typed: Typed
) -> dict[str, Any]:
    """Return the result of ``keymint verify``.

    Args:
        comparisons: one for each transport.
        subjects: the subjects that were verified.
        edges: the number of edges that each transport was asked for.
        typed: returns a path as the user would type it.
    """
    return {
        "subjects": subjects,
        "edges": edges,
        "transports": [
            {
                "name": comparison.transport,
                "version": comparison.version,
                "tier": comparison.tier,
                "confusion": asdict(comparison.confusion),
                "findings": [_mismatch(mismatch, typed) for mismatch in comparison.findings],
                "findings_omitted": comparison.omitted,
            }
            for comparison in comparisons
        ],
    }


def _mismatch(mismatch: Mismatch, typed: Typed) -> dict[str, Any]:
    return {
        "error": mismatch.error,
        "edge": edge_json(mismatch.edge),
        "request": request_text(mismatch.edge),
        "policy": decision_json(mismatch.policy, typed),
        "transport": verdict_json(mismatch, typed),
    }
