# SPDX-License-Identifier: Apache-2.0
"""Write rules as a ComArmor policy, in the form of learned ones, and read it again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import comarmor
from comarmor.errors import ComArmorError, Diagnostic
from comarmor.language.attachments import MOST_CHARACTERS
from comarmor.language.parse import parse
from comarmor.language.source import read_document
from comarmor.language.syntax import ProfileRule
from comarmor.rules import Effect, Rule
from keymint.api import PolicyOfRules
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint_ros2_comarmor.learned_document import profiles
from keymint_ros2_comarmor.learned_rules import fold


def policy_of(subjects: Sequence[SubjectRules], name: str, note: str = "") -> PolicyOfRules:
    """Write a policy; see :meth:`keymint.api.PolicyWriter.policy_of`.

    Raises:
        KeymintError: an expression or the name of a subject cannot be written.
    """
    if too_long := [
        _too_long(each, rule) for each in subjects for rule in each.rules if _length(rule) > MOST_CHARACTERS
    ]:
        raise KeymintError.of(too_long)
    document = profiles({each.subject: _folded(each.rules) for each in subjects}, note.replace("--", "- -"))
    policy = _read(document, name)
    return PolicyOfRules(document, tuple(SubjectRules(each.subject, policy.rules(each.subject)) for each in subjects))


def _folded(rules: Iterable[Rule]) -> tuple[ProfileRule, ...]:
    found: tuple[ProfileRule, ...] = ()
    for effect in Effect:
        needs = (
            (rule.kind, expression, permission, rule.partitions)
            for rule in rules
            if rule.effect is effect
            for expression in rule.expressions
            for permission in rule.permissions
        )
        found += fold(needs, effect)
    return found


def _read(document: bytes, name: str) -> comarmor.Policy:
    """Return the policy of a document; it includes nothing, so that it may be read from anywhere."""
    try:
        return parse(read_document(document, name, Path("/")))
    except ComArmorError as error:
        raise KeymintError.of(error.diagnostics) from None


def _length(rule: Rule) -> int:
    return max(map(len, (*rule.expressions, *rule.partitions)))


def _too_long(subject: SubjectRules, rule: Rule) -> Diagnostic:
    message = f"has a name of more than {MOST_CHARACTERS:,} characters, which no policy can hold"
    return Diagnostic.error("expression", message, rule.origin, "shorten it", subject.subject)
