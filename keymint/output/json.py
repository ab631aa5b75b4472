# SPDX-License-Identifier: Apache-2.0
"""The JSON of the results of verbs, as Python objects; ``docs/json.md`` describes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from comarmor.errors import Origin
from keymint.analysis.policy_diff import SubjectChanges
from keymint.api import PolicyDecision, Verdict
from keymint.api.graph import Edge
from keymint.output.mismatches import request_text
from keymint.output.report import members
from keymint.verify.mismatch import EdgeComparison, Mismatch

Typed = Callable[[str], str]
"""Returns a path as the user would type it."""


# -- places, edges and decisions -------------------------------------------------------------------------------------


def place_json(where: Origin | None, typed: Typed) -> Mapping[str, Any] | None:
    """Return a place, with the places that include it."""
    if where is None:
        return None
    return {
        "file": typed(where.file),
        "line": where.line or None,
        "included_from": [{"file": typed(outer.file), "line": outer.line} for outer in where.chain],
    }


def line_json(where: Origin | None, typed: Typed = str) -> Mapping[str, Any] | None:
    """Return the file and the line of a place."""
    return {"file": typed(where.file), "line": where.line or None} if where else None


def edge_json(edge: Edge) -> dict[str, Any]:
    """Return an edge as JSON data."""
    return {
        "subject": edge.subject,
        "permission": edge.permission,
        "kind": edge.object.kind,
        "object": edge.object.name,
        "partitions": edge.object.partitions,
        "domain": edge.domain,
    }


def decision_json(decision: PolicyDecision, typed: Typed) -> dict[str, Any]:
    """Return the decision of a policy."""
    return {
        "allowed": decision.allowed,
        "reason": str(decision.reason),
        "rule": place_json(decision.where, typed),
        "audit": decision.audit,
    }


def verdict_json(verdict: Verdict, reason: str, document: Origin | None, model: str, typed: Typed) -> dict[str, Any]:
    """Return the decision of a transport.

    Args:
        verdict: the decision, with the transport's own words.
        reason: the reason, in the words of the simulated transport that explains it, if there is one.
        document: the rule in the enclave's document that decides.
        model: the simulated transport that explains it, or empty.
        typed: returns a path as the user would type it.
    """
    return {
        "allowed": verdict.allowed,
        "reason": reason,
        "said": verdict.reason,
        "rule": place_json(document, typed),
        "deviation": verdict.deviation or None,
        "explained_by": model or None,
    }


# -- verify ----------------------------------------------------------------------------------------------------------


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
        "transport": verdict_json(mismatch.verdict, mismatch.reason, mismatch.document, mismatch.model, typed),
    }


# -- diff ------------------------------------------------------------------------------------------------------------


def differences_json(differences: Sequence[SubjectChanges], typed: Typed) -> list[dict[str, Any]]:
    """Return the differences of two policies as JSON data."""
    return [
        {
            "subject": each.subject or None,
            "stands_for": each.like or None,
            "except": [*each.excluded],
            "applies": {"before": each.before, "after": each.after},
            "changes": [
                {
                    "change": "gains" if change.gains else "loses",
                    **members(change, "kind", "permission"),
                    "pattern": change.pattern,
                    **members(change, "whole", "example"),
                    "rule": line_json(change.where, typed),
                    "unknown": change.unknown or None,
                }
                for change in each.changes
            ],
        }
        for each in differences
    ]
