"""What in a policy is in vain, or is likely not meant: rules without effect, and names that nothing has.

A rule is in vain only if it is so for every subject that it applies to: those that the policy names, and one example of
each pattern of subjects that its profiles match.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial

from comarmor.errors import Diagnostic, Origin, Severity, Spot
from comarmor.patterns.ros_names import advice
from keymint.analysis.attachment_mistakes import CODES as SLIPS
from keymint.analysis.attachment_mistakes import attachment_mistakes
from keymint.analysis.attachments import AttachmentIndex
from keymint.analysis.name_similarity import similar_names, similar_subjects
from keymint.analysis.redundant_rules import (
    MOST_PAIRS,
    RedundantRules,
    can_name_exist,
    warning,
    within_bounds,
)
from keymint.analysis.subject_patterns import pattern_examples, rules_of, structure
from keymint.analysis.unreachable_profiles import unreachable_profiles
from keymint.api import LoadedPolicy
from keymint.ir import Rule

CODES: Mapping[str, str] = {
    "rule-shadowed": "An ALLOW rule allows nothing, because DENY rules deny all of it.",
    "rule-redundant": "What an ALLOW rule allows is allowed by other rules as well.",
    "deny-redundant": "What a DENY rule denies is denied by other rules as well.",
    "deny-nothing": "A DENY rule denies nothing that any rule allows.",
    "object-never": "No object can have a name that an expression matches.",
    "subject-never": "No subject can have a name that an attachment matches.",
    "profile-never": "A profile never applies together with the profiles around it.",
    "tunable-unused": "A tunable is declared, and nothing uses it.",
    "name-similar": "A name is nearly, but not quite, one that would fit.",
    **SLIPS,
    "lint-unknown": "Something was not found out within the steps that it may take.",
}
"""The findings of this room, each with one line that says what it means."""


def lint(policy: LoadedPolicy) -> list[Diagnostic]:
    """Return findings on a policy, by place.

    Args:
        policy: the policy.
    """
    written = structure(policy)
    named = policy.subjects()
    given_up: list[str] = []
    subjects, left_out = within_bounds((*named, *pattern_examples(policy, given_up)), partial(rules_of, policy))
    attachments = AttachmentIndex(written)
    found = [*_names(subjects, attachments), *(unreachable_profiles(written) if written else ())]
    if left_out:
        given_up.append(f"there are more than {MOST_PAIRS:,} pairs of a subject and a rule")
        found += map(_unknown, given_up)
    else:
        found += RedundantRules(subjects, attachments, written).findings()
        found += map(_unknown, given_up)
    found += similar_names({subject: subjects[subject] for subject in named if subject in subjects}, attachments)
    found += (*similar_subjects(written), *attachment_mistakes(written)) if written else ()
    return sorted_diagnostics(found)


def _unknown(reason: str) -> Diagnostic:
    return Diagnostic(
        "lint-unknown",
        Severity.NOTE,
        f"not every rule was looked at for every subject: {reason}",
        None,
        "a finding may not hold for some subjects, and some may be missing; lint parts of the policy",
    )


def sorted_diagnostics(found: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Return diagnostics by place, without doubles."""
    nowhere = Origin("")
    return sorted(
        dict.fromkeys(found),
        key=lambda each: ((each.where or nowhere).spot, each.code, each.message),
    )


def _names(subjects: Mapping[str, tuple[Rule, ...]], attachments: AttachmentIndex) -> Iterator[Diagnostic]:
    """Yield expressions that no object can match, whatever the subject."""
    verdicts: dict[tuple[Spot, str], tuple[bool, Rule, str]] = {}
    for subject, rules in subjects.items():
        for rule in rules:
            for expression in rule.expressions:
                key = (rule.origin.spot, expression)
                if key not in verdicts:
                    verdicts[key] = (can_name_exist(rule, expression), rule, subject)
    for (_, expression), (fine, rule, subject) in verdicts.items():
        if not fine:
            help_ = "remove it" if rule.kind == "topic" else advice(expression)
            message = f"no object can be named as {expression!r} says in this {rule.effect} {rule.kind} rule"
            yield warning("object-never", message, attachments.of(rule, subject)[expression].where, help_)
