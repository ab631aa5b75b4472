# SPDX-License-Identifier: Apache-2.0
"""Read the decisions of Zenoh's access control from its log.

With :data:`FILTER` in ``RUST_LOG`` each decision is a line. When a session declares a publisher on a literal key, both
ends of its link decide on this key at once, for all messages and both flows, and nothing is sent. For a key with
wildcards only the messages that are really sent are decided. If several subjects match a link, each has its line, and
one that allows is enough. A link that no subject matches is decided when it opens, once for all messages.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from comarmor.regex import lazy_regex
from comarmor.values import dataclass

FILTER = "zenoh::net::routing::interceptor::access_control=trace"

MESSAGES = {
    "Put": "put",
    "Delete": "delete",
    "Query": "query",
    "Reply": "reply",
    "Subscriber": "declare_subscriber",
    "Queryable": "declare_queryable",
    "Liveliness Token": "liveliness_token",
    "Liveliness Query": "liveliness_query",
    "Liveliness Subscriber": "declare_liveliness_subscriber",
}
"""The names of messages in a configuration by those in the log, without ``Declare`` and ``Undeclare``."""

_COLOUR = lazy_regex(r"\x1b\[[0-9;]*m")
_DECISION = lazy_regex(
    r" (?:(?P<zid>[0-9a-f]+) on Interface\(.*|Using cached result: (?P<cached>[0-9a-f]+)) "
    r"is (?P<refused>un)?authorized to (?:Declare/Undeclare |Declare |Undeclare )?"
    r"(?P<message>" + "|".join(sorted(MESSAGES, key=len, reverse=True)) + r") "
    r"\((?P<flow>ingress|egress)\) on (?P<key>.+)\n"
)
_NO_SUBJECT = lazy_regex(
    r" (?P<zid>[0-9a-f]+) did not match any configured ACL subject\. Default permission `(?P<default>Allow|Deny)`"
)


@dataclass(frozen=True, slots=True)
class LoggedDecision:
    """A decision of Zenoh, or of one of several subjects that match the link.

    Attributes:
        zid: identifier of the session at the other end of the link.
        allowed: the decision.
        message: as configurations name it; empty if no subject matches the link, which decides all its messages.
        flow: ``ingress`` or ``egress``, as seen from the process that decides; empty for all messages.
        key: the key expression of the message; empty for all messages.
    """

    zid: str
    allowed: bool
    message: str = ""
    flow: str = ""
    key: str = ""


def combined_decisions(lines: Iterable[LoggedDecision]) -> list[LoggedDecision]:
    """Return one decision for each link, message, flow and key: allowed if one of the subjects allows."""
    found: dict[LoggedDecision, bool] = {}
    for line in lines:
        what = replace(line, allowed=False)
        found[what] = found.get(what, False) or line.allowed
    return [replace(what, allowed=allowed) for what, allowed in found.items()]


def lines(log: str) -> Iterator[LoggedDecision]:
    """Yield the lines of a log that are decisions, in order; an unfinished last line is none."""
    for coloured in log.splitlines(keepends=True):
        line = _COLOUR.sub("", coloured)
        if found := _DECISION.search(line):
            allowed, zid = not found["refused"], found["zid"] or found["cached"]
            yield LoggedDecision(zid, allowed, MESSAGES[found["message"]], found["flow"], found["key"])
        elif found := _NO_SUBJECT.search(line):
            yield LoggedDecision(found["zid"], found["default"] == "Allow")
