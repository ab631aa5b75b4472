# SPDX-License-Identifier: Apache-2.0
"""Runs policies through all stages and counts the steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from keymint_ros2_dds.settings import package_of

from comarmor.errors import Origin
from comarmor.patterns.steps import step_limit
from keymint.analysis.lint_rules import lint
from keymint.analysis.policy_diff import diff_policies
from keymint.analysis.subject_patterns import rules_of
from keymint.api import BuildOptions, LoadedPolicy, PolicySource
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from tests.conftest import installed_plugins

COMPILE = 17_000_000
"""Most steps of compiling a subject: two orders of its rules, the proofs of its document, and a small margin."""
REFUSED = ("portability-effort",)
TOO_MANY = ("in too many ways", "too complex to compute")
NOW = datetime(2026, 1, 1, tzinfo=UTC)


@dataclass
class Tally:
    """The counts of a sweep."""

    policies: int = 0
    subjects: int = 0
    most: dict[str, tuple[int, str]] = field(default_factory=dict)
    refused: list[str] = field(default_factory=list)
    unproven: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    unportable: int = 0

    def count(self, stage: str, steps: int, name: str) -> None:
        """Record the steps of a stage."""
        self.most[stage] = max(self.most.get(stage, (0, "")), (steps, name))


class Sweep:
    """Runs policies through all stages.

    Args:
        folder: where policies are written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        plugins = installed_plugins()
        self._policies = plugins.policy_type("keymint_ros2_comarmor")
        self._compiler = plugins.build_type("keymint_ros2_dds")
        self.tally = Tally()

    def load(self, text: str) -> LoadedPolicy:
        """Load a policy from its text."""
        path = self._folder / "policy.xml"
        path.write_text(text)
        return self._policies.load([PolicySource("policy", path, Origin("policy.xml"))], None)

    def run(self, name: str, text: str, other: str = "") -> None:
        """Run one policy, and the comparison with another one."""
        self.tally.policies += 1
        policy = self.load(text)
        self._asked("lint", name, lambda: self._linted(name, policy))
        if other:
            changed = self.load(other)
            self._asked("diff", name, lambda: diff_policies(policy, changed))
        for subject in policy.subjects():
            self.tally.subjects += 1
            self._asked("compile", name, lambda subject=subject: self._compiled(name, policy, subject))

    def _asked(self, stage: str, name: str, ask: Callable[[], object]) -> None:
        with step_limit(None) as effort:
            ask()
        self.tally.count(stage, effort.spent, name)

    def _linted(self, name: str, policy: LoadedPolicy) -> None:
        if any(each.code == "lint-unknown" for each in lint(policy)):
            self.tally.unknown.append(name)

    def _compiled(self, name: str, policy: LoadedPolicy, subject: str) -> None:
        package = package_of(SubjectRules(subject, rules_of(policy, subject)), "humble")
        try:
            found = self._compiler.build(package, BuildOptions()).diagnostics
        except KeymintError as error:
            hard = [
                each
                for each in error.diagnostics
                if each.code in REFUSED or any(text in each.message for text in TOO_MANY)
            ]
            if not hard:
                self.tally.unportable += 1
            elif name not in self.tally.refused:
                self.tally.refused.append(name)
        else:
            if any(each.code == "compile-unproven" for each in found):
                self.tally.unproven.append(f"{name} {subject}")


def changed(text: str) -> str:
    """Return a policy whose first ALLOW rule became a DENY rule."""
    return text.replace('qualifier="ALLOW"', 'qualifier="DENY"', 1)
