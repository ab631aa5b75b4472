# SPDX-License-Identifier: Apache-2.0
"""Rules that are read later."""

from __future__ import annotations

import pickle
from unittest import mock

import pytest

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.errors import KeymintError
from keymint.ir import DeferredRules, Rule, SubjectRules

RULES = (Rule(Effect.ALLOW, "ros_topic", ("ros_publish",), ("/chatter",), (), audit=False, origin=Origin("p.xml", 1)),)


def test_rules_are_read_once_when_they_are_asked_for() -> None:
    read = mock.Mock(return_value=RULES)
    deferred = DeferredRules("/talker", read)
    assert deferred.subject == "/talker"
    read.assert_not_called()
    assert deferred.rules == deferred.rules == RULES
    read.assert_called_once()


def test_another_process_gets_rules_that_were_read() -> None:
    deferred = DeferredRules("/talker", lambda: RULES)
    assert pickle.loads(pickle.dumps(deferred)) == SubjectRules("/talker", RULES)


def test_the_error_of_reading_is_raised_at_each_access() -> None:
    deferred = DeferredRules("/talker", mock.Mock(side_effect=KeymintError("damaged")))
    for _ in range(2):
        with pytest.raises(KeymintError, match="damaged"):
            _ = deferred.rules
