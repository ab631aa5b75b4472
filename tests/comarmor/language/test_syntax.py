# SPDX-License-Identifier: Apache-2.0
"""Attachments, rules of profiles and decisions, as data."""

from __future__ import annotations

import pytest

from comarmor import Attachment, Decision, Effect, Origin, ProfileRule, Rule
from comarmor.errors import Reason
from comarmor.language.attachments import NAMESPACE

HERE, THERE = Origin("policy.xml", 1), Origin("policy.xml", 2)


def test_an_attachment_is_expanded_for_the_subject_only_if_it_depends_on_it() -> None:
    own = Attachment.of((NAMESPACE, "x"), HERE)
    assert (own.text, own.for_parts("/r/", "a"), own.for_parts("/", "b")) == ("{namespace}x", "/r/x", "/x")
    escaped = Attachment.of(("/\\{name\\}",), HERE)
    assert escaped.for_parts("/r/", "a") == escaped.text == "/\\{name\\}"


def test_a_rule_of_a_profile_keeps_everything_but_repeated_expressions() -> None:
    attachments = (Attachment.of(("/x",), HERE), Attachment.of((NAMESPACE, "x"), HERE))
    written = ProfileRule(Effect.DENY, "topic", ("publish",), attachments, ("p",), True, THERE)
    expanded = written.with_expressions(attachment.for_parts("/", "a") for attachment in attachments)
    assert expanded == Rule(Effect.DENY, "topic", ("publish",), ("/x",), ("p",), True, THERE)


@pytest.mark.parametrize("audits", [(), (False,), (False, True)])
def test_a_decision_refers_to_its_first_rule_and_is_logged_if_any_rule_asks_for_it(audits) -> None:
    rules = tuple(
        Rule(Effect.ALLOW, "topic", ("publish",), ("x",), (), audit, Origin("policy.xml", number))
        for number, audit in enumerate(audits, 1)
    )
    decision = Decision("topic", "publish", "x", (), Effect.ALLOW, rules, Reason(("because",)))
    assert decision.allowed
    assert decision.rule is (rules[0] if rules else None)
    assert decision.where == (HERE if rules else None)
    assert decision.audit is any(audits)
