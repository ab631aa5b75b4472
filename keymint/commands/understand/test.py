# SPDX-License-Identifier: Apache-2.0
"""``keymint test``: run the unit tests of a policy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from keymint.analysis.policy_tests import ExpectationChecker, ExpectationResult, diagnostics
from keymint.api import Expectation
from keymint.command_line.named_files import write_outputs
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import Number, PolicyOptions, policy_options
from keymint.command_line.verb import FILE, PATH, Report, Run, argument, findings_if, option, path_option, verb
from keymint.errors import Defects, Diagnostic, KeymintError, Origin, Spot, usage_error
from keymint.ir import Rule
from keymint.output.junit import JUnitCase, junit as junit_document


@verb()
def test(
    run: Run,
    policy: Path | None = argument(required=False, type=PATH),
    junit: Path | None = path_option(kind=FILE),
    min_coverage: float = option(type=Number(0, 100), default=0.0, metavar="PERCENT"),
    policy_options: PolicyOptions = policy_options,
) -> Report:
    """Run the unit tests of POLICY: NAME.test.xml beside NAME.xml, or all *.test.xml in its directory.

    \b
    <tests>
      <test name="guests stay away from safety">
        <allow subject="/guest/ui" permission="subscribe" object="/status"/>
        <deny subject="/guest/*" permission="call" object="/safety/*"/>
      </test>
    </tests>

    <deny> must be true for every subject and every name that the expressions match, including those that the policy
    does not name. <allow> must be true for every name, and for every subject that the policy names. -v lists the rules
    that no expectation covers. docs/verification.md says in one table what each verb reads.

    Exit code 3: an expectation fails, or rule coverage is below --min-coverage.

    Options:
        junit: Write JUnit XML.
        min_coverage: Fail if rule coverage is below PERCENT [0].
    """
    if 0 < min_coverage < 1:
        message = f"--min-coverage {min_coverage:g} is less than one percent"
        raise usage_error(message, f"PERCENT goes to 100: --min-coverage {100 * min_coverage:g}")
    policies = Policies(run, policy_options)
    policy_type = run.plugins.policy_type(policy_options.policy_type)
    folders, library = policies.places(policy)
    missing = next((folder for folder in folders if not folder.exists()), None)
    if missing is not None:
        shown = run.typed(str(missing))
        message, help_ = f"the policy {shown!r} does not exist", "name a policy, or its directory"
        raise KeymintError(message, where=Origin(shown), help=help_, code="policy-missing")
    files: dict[Path, Sequence[Expectation]] = {}
    for folder in folders:
        expectations = policy_type.expectations(folder)
        if expectations is None:
            raise KeymintError(f"the policy type {policy_options.policy_type} has no unit tests", code="tests-none")
        files |= expectations
    if not any(files.values()):
        shown = run.typed(str(folders[0]))
        beside = f"{shown}/*.test.xml" if folders[0].is_dir() else f"{shown.removesuffix('.xml')}.test.xml"
        raise KeymintError("the policy has no tests", where=Origin(shown), help=f"write {beside}", code="tests-none")
    checks = ExpectationChecker(policies.load(policy))
    by_file = {run.typed(str(file)): _checked(checks, expected) for file, expected in files.items()}
    results = [result for checked in by_file.values() for result in checked]
    rules = _own(checks.rules(), folders, library)
    exercised = {place for result in results for place in result.exercised}
    idle = [rule for place, rule in rules.items() if place not in exercised]
    percent = 100 * (len(rules) - len(idle)) / len(rules) if rules else 100.0
    warnings = [*diagnostics(results), *_idle(idle)]
    if percent < min_coverage:
        message = f"rule coverage is {int(10 * percent) / 10:g} %, below {min_coverage:g} %"
        warnings.append(Diagnostic.error("coverage-low", message, help="'keymint test -v' lists the others"))
    if junit is not None:
        suites = {file: [*_cases(file, checked)] for file, checked in by_file.items()}
        write_outputs(run, junit, junit_document("keymint test", suites))
    broken = sum(bool(result.failure) for result in results)
    run.console.line(
        f"{len(results) - broken} of {len(results)} expectations hold; "
        f"{len(rules) - len(idle)} of {len(rules)} rules are exercised ({percent:.0f} %)"
    )
    result = {
        "files": {
            file: {"expectations": len(checked), "failed": sum(bool(result.failure) for result in checked)}
            for file, checked in by_file.items()
        },
        "expectations": len(results),
        "failed": broken,
        "rules": len(rules),
        "exercised": len(rules) - len(idle),
    }
    return run.report(result, warnings, findings_if(broken or percent < min_coverage))


def _checked(checks: ExpectationChecker, expected: Sequence[Expectation]) -> list[ExpectationResult]:
    """Check the expectations of a file; raise the defects of all of them together."""
    defects = Defects()
    results = [defects.attempt(partial(checks.check, expectation)) for expectation in expected]
    defects.require_none()
    return [result for result in results if result]


def _own(rules: Mapping[Spot, Rule], folders: Sequence[Path], library: Path) -> dict[Spot, Rule]:
    """Return the rules of the policy itself, without the library's."""
    own_folders = [folder if folder.is_dir() else folder.parent for folder in folders]
    own_rules: dict[Spot, Rule] = {}
    for place in sorted(rules):
        file = Path(place[0]).resolve()
        if any(file.is_relative_to(folder) for folder in own_folders) and not file.is_relative_to(library):
            own_rules[place] = rules[place]
    return own_rules


def _idle(rules: Sequence[Rule]) -> list[Diagnostic]:
    return [
        Diagnostic.note(
            "rule-untested",
            f"no expectation covers this {rule.effect} {rule.kind} rule ({', '.join(rule.permissions)})",
            rule.origin.alone(),
        )
        for rule in rules
    ]


def _cases(file: str, results: Sequence[ExpectationResult]) -> Iterator[JUnitCase]:
    """Yield the results of a file: a test case for each of its tests."""
    tests: dict[str, list[ExpectationResult]] = {}
    for result in results:
        tests.setdefault(result.expectation.test, []).append(result)
    for name, test in tests.items():
        failed = [result for result in test if result.failure]
        lines = [f"{file}:{result.expectation.where.line}: {result.failure}" for result in failed]
        yield JUnitCase(file, name, ("expectation", failed[0].failure) if failed else None, "\n".join(lines))
