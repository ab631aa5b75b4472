"""Findings as SARIF 2.1.0 (OASIS, "Static Analysis Results Interchange Format"), for code review and security tabs."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any
from urllib.parse import quote

from keymint import __version__
from keymint.errors import Origin
from keymint.verify.model import Error, Finding, Outcome
from keymint.verify.words import in_words, request

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
_RULES = {
    Error.FALSE_POSITIVE: "A transport allows what the policy does not.",
    Error.FALSE_NEGATIVE: "A transport denies what the policy allows.",
}


def sarif(outcomes: Sequence[Outcome], typed: Callable[[str], str]) -> bytes:
    """Return a SARIF log with one result for each finding; the policy's rule is its place, the document's related.

    Args:
        outcomes: what came of each transport.
        typed: returns a path as it is to be written, relative to the root of the repository if possible.
    """
    rules = [
        {"id": str(error), "shortDescription": {"text": text}, "defaultConfiguration": {"level": "error"}}
        for error, text in _RULES.items()
    ]
    driver = {
        "name": "keymint verify",
        "version": __version__,
        "semanticVersion": __version__,
        "rules": rules,
    }
    results = [_result(outcome, finding, typed) for outcome in outcomes for finding in outcome.findings]
    runs = [{"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": results}]
    log = {"$schema": _SCHEMA, "version": "2.1.0", "runs": runs}
    return (json.dumps(log, indent=1, ensure_ascii=True) + "\n").encode()


def _result(outcome: Outcome, finding: Finding, typed: Callable[[str], str]) -> dict[str, Any]:
    document = _location(finding.document, typed)
    where = finding.policy.where
    edge = finding.edge
    return {
        "ruleId": str(finding.error),
        "ruleIndex": list(_RULES).index(finding.error),
        "level": "error",
        "message": {"text": in_words([outcome.transport], finding)},
        "locations": [_location(where, typed) if where else document],
        "relatedLocations": [{**document, "message": {"text": finding.reason or "the enclave's document"}}],
        "partialFingerprints": {"keymintEdge/v1": f"{outcome.transport}|{request(edge)}|{edge.domain}"},
    }


def _location(where: Origin, typed: Callable[[str], str]) -> dict[str, Any]:
    place: dict[str, Any] = {"artifactLocation": {"uri": _uri(typed(where.file))}}
    if where.line:
        place["region"] = {"startLine": where.line}
    return {"physicalLocation": place}


def _uri(path: str) -> str:
    return ("file://" if path.startswith("/") else "") + quote(path)
