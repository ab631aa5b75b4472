# SPDX-License-Identifier: Apache-2.0
"""Places, edges and decisions in the JSON of verbs, as Python objects; ``docs/json.md`` describes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from keymint.api import PolicyDecision
from keymint.api.graph import Edge
from keymint.errors import Origin
from keymint.verify.compare import Mismatch

Typed = Callable[[str], str]
"""Returns a path as the user would type it."""


def place_json(where: Origin | None, typed: Typed) -> Mapping[str, Any] | None:
    """Return a place, with the places that include it."""
    included = [{"file": typed(outer.file), "line": outer.line} for outer in (where.chain if where else ())]
    line = line_json(where, typed)
    return {**line, "included_from": included} if line else None


def line_json(where: Origin | None, typed: Typed = str) -> Mapping[str, Any] | None:
    """Return the file and the line of a place."""
    if where is None:
        return None
    return {"file": typed(where.file), "line": where.line or None} | ({"source": where.source} if where.source else {})


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


def verdict_json(label: Mismatch, typed: Typed) -> dict[str, Any]:
    """Return the decision of a transport.

    Args:
        label: the decision, which may be the policy's, too.
        typed: returns a path as the user would type it.
    """
    return {
        "allowed": label.verdict.allowed,
        "reason": label.reason,
        "said": label.verdict.reason,
        "rule": place_json(label.document, typed),
        "deviation": label.verdict.deviation or None,
        "explained_by": label.model or None,
    }
