# SPDX-License-Identifier: Apache-2.0
"""The reader of Zenoh's log, on lines that Zenoh 1.10.2 wrote."""

from __future__ import annotations

from keymint_ros2_zenoh.documents.configuration import Message
from keymint_ros2_zenoh.vendors import zenoh_processes
from keymint_ros2_zenoh.vendors.zenoh_processes import LoggedDecision

PREFIX = "\x1b[2m2026-11-22T10:46:21Z\x1b[0m \x1b[35mTRACE\x1b[0m \x1b[2mzenoh::acl\x1b[0m\x1b[2m:\x1b[0m "
LINK = "a336 on Interface(lo)+CertCommonName(/a)+Transport(Tls)+a336"


def read(*lines: str) -> list[LoggedDecision]:
    return list(zenoh_processes.lines("".join(f"{PREFIX}{line}\n" for line in lines)))


def test_decisions_of_all_kinds_of_lines() -> None:
    assert read(
        "ACL (ingress): caching permissions for `0/x/y` ...",
        f"{LINK} is unauthorized to Query (ingress) on 0/x/y",
        f"{LINK} is authorized to Declare/Undeclare Liveliness Token (egress) on 0/x/y",
        f"{LINK} is authorized to Declare Liveliness Subscriber (ingress) on 0/*/y",
        "Using cached result: a336 is unauthorized to Declare Subscriber (ingress) on 0/x/y",
        f"{LINK} is authorized to Undeclare Queryable (ingress) on 0/(ingress) on x",
    ) == [
        LoggedDecision("a336", False, "query", "ingress", "0/x/y"),
        LoggedDecision("a336", True, "liveliness_token", "egress", "0/x/y"),
        LoggedDecision("a336", True, "declare_liveliness_subscriber", "ingress", "0/*/y"),
        LoggedDecision("a336", False, "declare_subscriber", "ingress", "0/x/y"),
        LoggedDecision("a336", True, "declare_queryable", "ingress", "0/(ingress) on x"),
    ]


def test_a_link_without_subject_is_decided_for_all_messages() -> None:
    line = "b1 did not match any configured ACL subject. Default permission `Deny` will be applied on all messages"
    assert read(line) == [LoggedDecision("b1", False)]


def test_an_unfinished_line_is_none() -> None:
    assert list(zenoh_processes.lines(f"{PREFIX}{LINK} is authorized to Put (ingress) on 0/x")) == []


def test_one_allowing_subject_is_enough() -> None:
    lines = [LoggedDecision("a", allowed, "put", "ingress", "0/x") for allowed in (False, True, False)]
    other = LoggedDecision("a", False, "put", "egress", "0/x")
    assert zenoh_processes.combined_decisions([*lines, other]) == [
        LoggedDecision("a", True, "put", "ingress", "0/x"),
        other,
    ]


def test_every_message_of_access_control_has_its_name_in_the_log() -> None:
    assert zenoh_processes.MESSAGES == {
        "Put": Message.PUT,
        "Delete": Message.DELETE,
        "Query": Message.QUERY,
        "Reply": Message.REPLY,
        "Subscriber": Message.DECLARE_SUBSCRIBER,
        "Queryable": Message.DECLARE_QUERYABLE,
        "Liveliness Token": Message.LIVELINESS_TOKEN,
        "Liveliness Query": Message.LIVELINESS_QUERY,
        "Liveliness Subscriber": Message.DECLARE_LIVELINESS_SUBSCRIBER,
    }
