# SPDX-License-Identifier: Apache-2.0
"""Check with a build type whether the rules of a policy can be compiled portably, without a package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns.steps import step_limit
from keymint.analysis.findings import undecided_note
from keymint.analysis.subject_patterns import with_distinct_rules
from keymint.api import RuleCheck
from keymint.ir import Rule, SubjectRules

STEPS = 40_000_000
"""Steps after which no further subject is checked (:mod:`comarmor.patterns.steps`).

Only work that is done counts: a subject that is like one this process compiled before costs next to nothing, so a
second run in the same process may check more subjects than the first one, never fewer.
"""


def portability(
    build_type: RuleCheck, distro: str, subjects: Iterable[tuple[str, tuple[Rule, ...]]]
) -> Iterator[Diagnostic]:
    """Yield rules of subjects that a build type cannot express, or that have no effect with it.

    Args:
        build_type: checks rules.
        distro: ROS 2 distribution whose name mapping applies.
        subjects: subjects with their rules.
    """
    reported: set[tuple[str, Origin | None, str]] = set()
    spent = 0
    for subject, rules in with_distinct_rules(subjects):
        if spent > STEPS:
            yield undecided_note(
                f"{subject} and the subjects after it were not compiled: {STEPS:,} steps were spent on those before it",
                None,
                "'keymint build' compiles each of them; or lint parts of the policy",
            )
            return
        with step_limit(None) as counter:
            diagnostics = list(_of_subject(build_type, SubjectRules(subject, rules), distro, reported))
        spent += counter.spent
        yield from diagnostics


def _of_subject(
    build_type: RuleCheck, rules: SubjectRules, distro: str, reported: set[tuple[str, Origin | None, str]]
) -> Iterator[Diagnostic]:
    for each in build_type.check_rules(rules, distro):
        where = each.where
        if each.severity is Severity.NOTE or where is None:
            continue
        key = (each.code, where.alone(), each.message if each.code == "never-matches" else "")
        if key not in reported:
            reported.add(key)
            yield replace(each, severity=Severity.WARNING, subject=each.subject or rules.subject)
