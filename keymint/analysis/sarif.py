"""Diagnostics as SARIF 2.1.0 (OASIS, "Static Analysis Results Interchange Format"), for code review."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from comarmor.errors import Diagnostic, Severity
from keymint.output.sarif import location, log

_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.NOTE: "note"}


def sarif(tool: str, codes: Mapping[str, str], found: Sequence[Diagnostic], typed: Callable[[str], str]) -> bytes:
    """Return a SARIF log with one result for each diagnostic.

    Args:
        tool: name of what looked, e.g. ``keymint lint``.
        codes: what findings mean, by code; one that is not listed gets its own message.
        found: diagnostics.
        typed: returns a path as it is to be written, relative to the root of the repository if possible.
    """
    met = {each.code: codes.get(each.code, each.message) for each in found}
    described = {**codes, **met}
    rules = [{"id": code, "shortDescription": {"text": text}} for code, text in described.items()]
    index = list(described)
    return log(tool, rules, [_result(each, index.index(each.code), typed) for each in found])


def _result(found: Diagnostic, index: int, typed: Callable[[str], str]) -> dict[str, Any]:
    said = found.message + (f" ({found.help})" if found.help else "")
    result: dict[str, Any] = {
        "ruleId": found.code,
        "ruleIndex": index,
        "level": _LEVELS[found.severity],
        "message": {"text": said},
    }
    if found.where:
        result["locations"] = [location(found.where, typed)]
        result["relatedLocations"] = [
            {**location(outer, typed), "message": {"text": "included from here"}} for outer in found.where.chain
        ]
    return result
