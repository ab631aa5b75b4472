"""Findings as SARIF 2.1.0 (OASIS, "Static Analysis Results Interchange Format"), for code review and security tabs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from keymint.graph import EdgeOutcome
from keymint.output.sarif import location, log
from keymint.verify.mismatch import Comparison, Mismatch
from keymint.verify.words import in_words, request

_RULES = {
    EdgeOutcome.FALSE_POSITIVE: "A transport allows what the policy does not.",
    EdgeOutcome.FALSE_NEGATIVE: "A transport denies what the policy allows.",
}


def sarif(outcomes: Sequence[Comparison], typed: Callable[[str], str]) -> bytes:
    """Return a SARIF log with one result for each finding; the policy's rule is its place, the document's related.

    Args:
        outcomes: what came of each transport.
        typed: returns a path as it is to be written, relative to the root of the repository if possible.
    """
    rules = [
        {"id": str(error), "shortDescription": {"text": text}, "defaultConfiguration": {"level": "error"}}
        for error, text in _RULES.items()
    ]
    return log(
        "keymint verify", rules, [_result(outcome, each, typed) for outcome in outcomes for each in outcome.findings]
    )


def _result(outcome: Comparison, finding: Mismatch, typed: Callable[[str], str]) -> dict[str, Any]:
    document = location(finding.document, typed)
    where = finding.policy.where
    edge = finding.edge
    return {
        "ruleId": str(finding.error),
        "ruleIndex": list(_RULES).index(finding.error),
        "level": "error",
        "message": {"text": in_words([outcome.transport], finding)},
        "locations": [location(where, typed) if where else document],
        "relatedLocations": [{**document, "message": {"text": finding.reason or "the enclave's document"}}],
        "partialFingerprints": {"keymintEdge/v1": f"{outcome.transport}|{request(edge)}|{edge.domain}"},
    }
