# SPDX-License-Identifier: Apache-2.0
"""SARIF logs: rules by index, and places with the places that include them."""

from __future__ import annotations

import json
from typing import Any

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.output.explanations import explanations
from keymint.output.sarif import of_diagnostics, sarif


def run_of(*diagnostics: Diagnostic) -> dict[str, Any]:
    log = json.loads(sarif("keymint lint", of_diagnostics(diagnostics), lambda file: f"typed/{file}"))
    (run,) = log["runs"]
    return run


def test_results_refer_to_their_rules_by_index() -> None:
    known, other = (
        Diagnostic("grant-expired", Severity.WARNING, "one"),
        Diagnostic("other", Severity.ERROR, "two", help="fix it"),
    )
    run = run_of(other, known)
    rules = run["tool"]["driver"]["rules"]
    assert [rule["id"] for rule in rules] == ["other", "grant-expired"]
    texts = [rule["shortDescription"]["text"] for rule in rules]
    assert texts == ["two (fix it)", explanations()["grant-expired"]["cause"]]
    assert [(rules[result["ruleIndex"]]["id"], result["level"]) for result in run["results"]] == [
        ("other", "error"),
        ("grant-expired", "warning"),
    ]
    assert run["results"][0]["message"]["text"] == "two (fix it)"
    assert "locations" not in run["results"][0]


def test_places_are_quoted_and_have_the_places_that_include_them() -> None:
    where = Origin("a b.xml", 3, (Origin("policy.xml", 7),), 5)
    (result,) = run_of(Diagnostic("code", Severity.NOTE, "message", where))["results"]
    (place,) = result["locations"]
    assert place["physicalLocation"] == {
        "artifactLocation": {"uri": "typed/a%20b.xml"},
        "region": {"startLine": 3, "startColumn": 5},
    }
    (related,) = result["relatedLocations"]
    assert related["message"]["text"] == "included from here"
    assert related["physicalLocation"]["region"] == {"startLine": 7}


def test_a_file_that_a_package_ships_has_its_address() -> None:
    where = Origin("package://nav2_bringup/a.xml", 3)
    log = json.loads(sarif("keymint lint", of_diagnostics([Diagnostic("c", Severity.NOTE, "m", where)]), str))
    (result,) = log["runs"][0]["results"]
    assert result["locations"][0]["physicalLocation"]["artifactLocation"] == {"uri": "package://nav2_bringup/a.xml"}
