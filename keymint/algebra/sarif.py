"""Diagnostics as SARIF 2.1.0 (OASIS, "Static Analysis Results Interchange Format"), for code review."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from urllib.parse import quote

from keymint import __version__
from keymint.errors import Diagnostic, Origin, Severity

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
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
    driver = {"name": tool, "version": __version__, "semanticVersion": __version__, "rules": rules}
    index = list(described)
    results = [_result(each, index.index(each.code), typed) for each in found]
    runs = [{"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": results}]
    log = {"$schema": _SCHEMA, "version": "2.1.0", "runs": runs}
    return (json.dumps(log, indent=1, ensure_ascii=True) + "\n").encode()


def _result(found: Diagnostic, index: int, typed: Callable[[str], str]) -> dict[str, Any]:
    said = found.message + (f" ({found.help})" if found.help else "")
    result: dict[str, Any] = {
        "ruleId": found.code,
        "ruleIndex": index,
        "level": _LEVELS[found.severity],
        "message": {"text": said},
    }
    if found.where:
        result["locations"] = [_location(found.where, typed)]
        result["relatedLocations"] = [
            {**_location(outer, typed), "message": {"text": "included from here"}} for outer in found.where.chain
        ]
    return result


def _location(where: Origin, typed: Callable[[str], str]) -> dict[str, Any]:
    path = typed(where.file)
    place: dict[str, Any] = {"artifactLocation": {"uri": ("file://" if path.startswith("/") else "") + quote(path)}}
    if where.line:
        place["region"] = {"startLine": where.line}
    return {"physicalLocation": place}
