# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of reports: merged if only the subject differs, and the exit code that they lead to."""

from __future__ import annotations

from dataclasses import replace

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.errors import ExitCode
from keymint.output.report import findings_exit, merged_diagnostics

SHARED = Diagnostic("grant-expired", Severity.ERROR, "the grant expired", Origin("defaults.xml", 4))


def test_a_defect_in_shared_defaults_is_reported_once() -> None:
    (merged,) = merged_diagnostics([replace(SHARED, subject=subject) for subject in ("/a", "/b", "/c")])
    assert merged.message == "the grant expired [3 packages]"
    assert merged.subject == ""


def test_two_stages_that_report_the_same_for_one_package_count_once() -> None:
    assert merged_diagnostics([replace(SHARED, subject="/a")] * 2) == (replace(SHARED, subject="/a"),)


def test_diagnostics_without_a_place_stay_separate() -> None:
    diagnostics = tuple(replace(SHARED, where=None, subject=subject) for subject in ("/a", "/b"))
    assert merged_diagnostics(diagnostics) == diagnostics


def test_notes_are_not_findings() -> None:
    note = replace(SHARED, severity=Severity.NOTE)
    assert findings_exit([note]) is ExitCode.DONE
    assert findings_exit([note, SHARED]) is ExitCode.FINDINGS
