"""The frame of a SARIF 2.1.0 log (OASIS, "Static Analysis Results Interchange Format"), for code review."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from urllib.parse import quote

from comarmor.errors import Origin
from keymint import __version__

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"


def log(tool: str, rules: Sequence[Mapping[str, Any]], results: Sequence[Mapping[str, Any]]) -> bytes:
    """Return a log of one run.

    Args:
        tool: name of what looked, e.g. ``keymint lint``.
        rules: reportingDescriptor objects (SARIF 3.49).
        results: result objects (SARIF 3.27), which name the rules by ``ruleIndex``.
    """
    driver = {"name": tool, "version": __version__, "semanticVersion": __version__, "rules": rules}
    runs = [{"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": results}]
    document = {"$schema": _SCHEMA, "version": "2.1.0", "runs": runs}
    return (json.dumps(document, indent=1, ensure_ascii=True) + "\n").encode()


def location(where: Origin, typed: Callable[[str], str]) -> dict[str, Any]:
    """Return a place as a location object (SARIF 3.28).

    Args:
        where: the place.
        typed: returns a path as it is to be written, relative to the root of the repository if possible.
    """
    path = typed(where.file)
    place: dict[str, Any] = {
        "artifactLocation": {"uri": ("file://" if path.startswith("/") else "") + quote(os.fsencode(path))}
    }
    if where.line:
        place["region"] = {"startLine": where.line} | ({"startColumn": where.column} if where.column else {})
    return {"physicalLocation": place}
