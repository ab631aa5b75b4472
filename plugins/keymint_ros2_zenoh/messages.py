# SPDX-License-Identifier: Apache-2.0
"""The vocabulary of Zenoh's access control: messages, flows and effects, as configurations spell them."""

from __future__ import annotations

from enum import StrEnum


class Message(StrEnum):
    """Messages that access control decides on."""

    PUT = "put"
    DELETE = "delete"
    DECLARE_SUBSCRIBER = "declare_subscriber"
    QUERY = "query"
    REPLY = "reply"
    DECLARE_QUERYABLE = "declare_queryable"
    LIVELINESS_TOKEN = "liveliness_token"  # noqa: S105 - no password
    LIVELINESS_QUERY = "liveliness_query"
    DECLARE_LIVELINESS_SUBSCRIBER = "declare_liveliness_subscriber"


class Flow(StrEnum):
    """Direction of a message on a link, as seen from the process whose configuration decides."""

    INGRESS = "ingress"
    EGRESS = "egress"

    @property
    def opposite(self) -> Flow:
        """The flow at the other end of the link: what enters the router leaves the session, and the reverse."""
        return Flow.EGRESS if self is Flow.INGRESS else Flow.INGRESS


class Permission(StrEnum):
    """Effect of a rule, or the default."""

    ALLOW = "allow"
    DENY = "deny"
