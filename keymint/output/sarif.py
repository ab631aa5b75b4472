# SPDX-License-Identifier: Apache-2.0
"""SARIF 2.1.0 logs (OASIS, "Static Analysis Results Interchange Format"), for code review and security dashboards."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import quote

from comarmor.xml.sandboxed_paths import PACKAGE
from keymint import __version__
from keymint.errors import Diagnostic, Origin, Severity
from keymint.output.explanations import explanations

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.NOTE: "note"}


class SarifResult(NamedTuple):
    """A result object (SARIF 3.27).

    Attributes:
        finding: what is wrong; its code is the rule that it violates.
        related: further places, each with a message; only of a result with a place.
        fingerprints: partial fingerprints (SARIF 3.27.17).
    """

    finding: Diagnostic
    related: Sequence[tuple[Origin, str]] = ()
    fingerprints: Mapping[str, str] = MappingProxyType({})


def of_diagnostics(diagnostics: Sequence[Diagnostic]) -> list[SarifResult]:
    """Return a result for each diagnostic; places that include it are related."""
    return [
        SarifResult(each, [(outer, "included from here") for outer in each.where.chain] if each.where else ())
        for each in diagnostics
    ]


def sarif(
    tool: str,
    results: Sequence[SarifResult],
    typed: Callable[[str], str],
    default_level: Severity | None = None,
) -> bytes:
    """Return a log of one run.

    Args:
        tool: name of the tool, e.g. ``keymint lint``.
        results: the results; a rule that nothing explains is described by the message of its last one.
        typed: returns a path as it is to be written, relative to the root of the repository if possible.
        default_level: level of every rule, written if given.
    """
    known = explanations()
    texts = {each: f"{each.message} ({each.help})" if each.help else each.message for each, _, _ in results}
    described = {each.code: known.get(each.code, {"cause": text})["cause"] for each, text in texts.items()}
    level = {} if default_level is None else {"defaultConfiguration": {"level": _LEVELS[default_level]}}
    descriptors = [{"id": rule, "shortDescription": {"text": text}} | level for rule, text in described.items()]
    index = {rule: number for number, rule in enumerate(described)}
    found: list[dict[str, Any]] = []
    for each, related, fingerprints in results:
        result: dict[str, Any] = {
            "ruleId": each.code,
            "ruleIndex": index[each.code],
            "level": _LEVELS[each.severity],
            "message": {"text": texts[each]},
        }
        if each.where:
            result["locations"] = [_location(each.where, typed)]
            result["relatedLocations"] = [
                {**_location(where, typed), "message": {"text": message}} for where, message in related
            ]
        if fingerprints:
            result["partialFingerprints"] = dict(fingerprints)
        found.append(result)
    driver = {"name": tool, "version": __version__, "semanticVersion": __version__, "rules": descriptors}
    log = {"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": found}
    document = {"$schema": _SCHEMA, "version": "2.1.0", "runs": [log]}
    return (json.dumps(document, indent=1, ensure_ascii=True) + "\n").encode()


def _location(where: Origin, typed: Callable[[str], str]) -> dict[str, Any]:
    """Return a place as a location object (SARIF 3.28)."""
    path = typed(where.file)
    scheme = "file://" if path.startswith("/") else PACKAGE if path.startswith(PACKAGE) else ""
    uri = scheme + quote(os.fsencode(path.removeprefix(PACKAGE)))
    place: dict[str, Any] = {"artifactLocation": {"uri": uri}}
    if where.line:
        place["region"] = {"startLine": where.line} | ({"startColumn": where.column} if where.column else {})
    return {"physicalLocation": place} | ({"properties": {"source": where.source}} if where.source else {})
