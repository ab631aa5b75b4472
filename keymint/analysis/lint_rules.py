# SPDX-License-Identifier: Apache-2.0
"""Report unreachable, redundant and suspicious policy rules.

A rule is reported only if it has no effect for every subject that it applies to: those that the policy names, and an
example of each pattern of subjects that its profiles match. Build types check, without a package, whether rules can be
compiled portably (:func:`portability`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from comarmor.patterns.glob import parse
from comarmor.patterns.possible_names import advice
from comarmor.patterns.relations import TooComplexError
from comarmor.patterns.steps import step_limit
from comarmor.rules import is_fully_qualified
from comarmor.text import did_you_mean
from comarmor.values import replace
from keymint.analysis.attachment_mistakes import attachment_mistakes
from keymint.analysis.findings import ExpressionOrigins, quoted_list, undecided_note
from keymint.analysis.name_similarity import similar_names, similar_subjects
from keymint.analysis.object_mistakes import object_mistakes
from keymint.analysis.redundant_rules import MOST_PAIRS, RedundantRules, can_name_exist, within_bounds
from keymint.analysis.rule_lists import RAW
from keymint.analysis.subject_patterns import (
    ROOT_ENCLAVE,
    can_exist,
    pattern_examples,
    profile_subjects,
    rules_of,
    with_distinct_rules,
)
from keymint.api import BuildType, LoadedPolicy, PolicyStructure, WrittenProfile
from keymint.errors import Diagnostic, Origin, Severity, Spot
from keymint.ir import Rule, SubjectRules


def lint(policy: LoadedPolicy) -> list[Diagnostic]:
    """Return the findings on a policy, sorted by place."""
    written = policy.structure()
    named = policy.subjects()
    given_up: list[str] = []
    subjects, complete = within_bounds(policy, (*named, *pattern_examples(policy, given_up)))
    attachments = ExpressionOrigins(written)
    findings = [*_names(subjects, attachments), *(_profiles(written) if written else ())]
    if complete:
        findings += RedundantRules(subjects, attachments, written).findings()
    else:
        given_up.append(f"there are more than {MOST_PAIRS:,} pairs of a subject and a rule")
    findings += [
        undecided_note(
            f"not every rule was checked for every subject: {reason}",
            "findings may not hold for some subjects, and some may be missing; lint parts of the policy",
        )
        for reason in given_up
    ]
    own = {subject: subjects[subject] for subject in named if subject in subjects}
    others = [rule for subject, rules in subjects.items() if subject not in own for rule in rules]
    findings += (*similar_names(own, attachments), *object_mistakes(policy, own, others, attachments))
    if written:
        findings += (*similar_subjects(written), *attachment_mistakes(written), *root_names(policy, written))
    return sorted_diagnostics(findings)


def sorted_diagnostics(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Return diagnostics sorted by place, without duplicates."""
    nowhere = Origin("")
    return sorted(
        dict.fromkeys(diagnostics),
        key=lambda each: ((each.where or nowhere).spot, each.code, each.message),
    )


def _names(subjects: Mapping[str, tuple[Rule, ...]], attachments: ExpressionOrigins) -> Iterator[Diagnostic]:
    """Yield expressions that no object can match, for any subject."""
    odd: dict[tuple[Spot, str], tuple[Rule, str]] = {}
    for subject, rules in subjects.items():
        for rule in rules:
            for expression in rule.expressions:
                if rule.kind == RAW or not is_fully_qualified(expression):
                    odd.setdefault((rule.origin.spot, expression), (rule, subject))
    for (_, expression), (rule, subject) in odd.items():
        if not can_name_exist(rule, expression):
            help_ = "remove it" if rule.kind == RAW else advice(expression)
            message = f"no legal object name matches {expression!r} in this {rule.effect} {rule.kind} rule"
            yield Diagnostic.warning("object-never", message, attachments.of(rule, subject)[expression].where, help_)


def _profiles(written: PolicyStructure) -> Iterator[Diagnostic]:
    """Yield profiles that never apply, attachments that no subject matches, and unused tunables."""
    for name, where in written.unused:
        yield Diagnostic.warning("tunable-unused", f"the tunable @{{{name}}} is never used", where, "remove it")
    for profile in written.profiles:
        applies = False
        for expression, where in profile.attachments:
            if not can_exist(parse(expression)):
                message = f"no subject name matches the attachment {expression!r} of profile {profile.name!r}"
                yield Diagnostic.warning("subject-never", message, where, "subject names look like /robot1/talker")
                continue
            try:
                reachable = any(can_exist(one) for one in profile_subjects((*profile.around, (expression,))))
            except TooComplexError:
                reachable = True
            applies = applies or reachable
            if not reachable and len(profile.attachments) > 1:
                why = f" to {expression!r}: the profiles around it apply only to {quoted_list(profile.around[-1])}"
                yield _never(profile, expression, where, why)
        if not applies and profile.around and len(profile.attachments) == 1:
            ((expression, where),) = profile.attachments
            around = quoted_list(profile.around[-1])
            why = f": no subject matches both its attachment {expression!r} and the profiles around it ({around})"
            yield _never(profile, expression, where, why)


def _never(profile: WrittenProfile, attachment: str, where: Origin, why: str) -> Diagnostic:
    help_ = did_you_mean(attachment, profile.around[-1], "fix the attachment, or move the profile out", similarity=0.8)
    return Diagnostic.warning("profile-never", f"profile {profile.name!r} never applies{why}", where, help_)


STEPS = 40_000_000
"""Steps after which no further subject is checked (:mod:`comarmor.patterns.steps`).

Only work that is done counts: a subject that is like one this process compiled before costs next to nothing, so a
second run in the same process may check more subjects than the first one, never fewer.
"""


def portability(
    build_type: BuildType, distro: str, subjects: Iterable[tuple[str, tuple[Rule, ...]]]
) -> Iterator[Diagnostic]:
    """Yield rules of subjects that a build type cannot express, or that have no effect with it.

    Args:
        build_type: checks rules.
        distro: ROS 2 distribution whose name mapping applies.
        subjects: subjects with their rules.
    """
    reported: set[tuple[str, Origin, str]] = set()
    spent = 0
    for subject, rules in with_distinct_rules(subjects):
        if spent > STEPS:
            yield undecided_note(
                f"{subject} and the subjects after it were not compiled: {STEPS:,} steps were spent on those before it",
                "'keymint build' compiles each of them; or lint parts of the policy",
            )
            return
        with step_limit(None) as counter:
            diagnostics = list(build_type.check_rules(SubjectRules(subject, rules), distro) or ())
        spent += counter.spent
        for each in diagnostics:
            if each.severity is Severity.NOTE or each.where is None:
                continue
            key = (each.code, each.where.alone(), each.message if each.code == "never-matches" else "")
            if key not in reported:
                reported.add(key)
                yield replace(each, severity=Severity.WARNING, subject=each.subject or subject)


def root_names(policy: LoadedPolicy, written: PolicyStructure) -> Iterator[Diagnostic]:
    """Yield a warning for each rule of the root enclave that contains ``{name}`` or ``{namespace}``."""
    if ROOT_ENCLAVE not in policy.subjects():
        return
    depends = {each.rule.origin.spot for each in written.clauses if each.expand("/a/", "a") != each.expand("/b/", "b")}
    for rule in rules_of(policy, ROOT_ENCLAVE):
        if rule.origin.spot in depends:
            message = (
                f"the root enclave '/' has no name, so this {rule.effect} {rule.kind} rule is about "
                f"{quoted_list(rule.expressions)}, and about none of the nodes that use the enclave"
            )
            help_ = "write the names of these nodes, with wildcards if they are not known, e.g. /*/get_parameters"
            yield Diagnostic.warning("root-name", message, rule.origin, help_, ROOT_ENCLAVE)
