# SPDX-License-Identifier: Apache-2.0
"""Random permissions documents and requests: as compilers or people write them, and unusual but legal ones."""

from __future__ import annotations

import random
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import TypeVar
from xml.sax.saxutils import escape

from keymint.api.graph import Edge, Object

_T = TypeVar("_T")

IDENTITY = "CN=/robot,OU=4f"
"""The subject name of all documents, in the order of RFC 2253."""

_SUBJECTS = [IDENTITY] * 24 + [
    "CN=/other,OU=4f", "OU=4f,CN=/robot", "CN=/robot, OU=4f", "CN=/robot", "CN=/robot/camera,OU=4f", "CN=/robot,OU=4f5",
    "CN=/robot,OU=4f,O=x", " CN=/robot,OU=4f", "CN=/ROBOT,OU=4f", "CN=/robot,OU=9",
]  # fmt: skip
_TOPICS = ["rt/a", "rt/b", "rt/ab", "rt/a/b", "rq/aRequest", "rr/aReply", "rt/a_b", "rt/a1", "raw", "rt/"]
_PATTERNS = [
    "*", "rt/*", "rt/a*", "r?/a", "rt/?", "*a", "rt/*b", "r*/a*", "rt/[ab]", "rt/[a-c]*", "rt/[!a]", "rt/[!a]*",
    "rt/a?b", "**", "?*", "rt/a/*", "rt/[ab][ab]", "rt/a[_/]b", "rq/*Request", "rt/[a-c]b", "[a-z]*",
]  # fmt: skip
_ODD_PATTERNS = [
    r"rt/\a", r"rt/\*", "rt/[^a]", "rt/[^a]*", "rt/[a", "rt/[]a]", "rt/[a-]", "rt/[!]", "rt/[[:alpha:]]", "rt/[a]-x",
    "[", "rt/[b-a]", "rt/[!a-]b", "rt/]", "rt/a]", "rt/[", "rt/[a-c-e]", "rt/[*]", " rt/a", "rt/a ", "rt/é",
]  # fmt: skip
_LISTS: list[list[str] | None] = [
    None, None, None, [""], ["a"], ["a", "b"], ["*"], ["a", ""], ["a*"], ["?"], ["[ab]"], ["b"], ["ab"], ["[!a]"],
]  # fmt: skip
_REQUESTED: list[tuple[str, ...]] = [
    (), (), ("",), ("a",), ("b",), ("a", "b"), ("", "a"), ("*",), ("ab",), ("a*",),
]  # fmt: skip
_DOMAINS = ["<id>0</id>"] * 16 + [
    "<id>1</id>", "<id>1</id><id>0</id>", "<id_range><min>0</min><max>9</max></id_range>",
    "<id_range><min>1</min><max>9</max></id_range>", "<id_range><min>0</min></id_range>",
    "<id_range><min>1</min></id_range>", "<id_range><max>9</max></id_range>",
]  # fmt: skip


class Writer:
    """Generates documents and requests, the same ones for the same seed.

    Args:
        seed: seed of the random numbers.
        now: the current time, UTC.
    """

    def __init__(self, seed: int, now: datetime) -> None:
        self._random = random.Random(seed)
        self._now = now

    def document(self) -> str:
        """Return an unsigned permissions document."""
        grants = "".join(self._grant(number) for number in range(self._some([1] * 6 + [2, 3])))
        return f'<?xml version="1.0" encoding="UTF-8"?>\n<dds><permissions>{grants}</permissions></dds>\n'

    def governance(self) -> str:
        """Return an unsigned governance document; most protect all topics."""
        control = self._some([("true", "true")] * 12 + [("false", "true"), ("true", "false"), ("false", "false")])
        rules = [("*", control)]
        if self._one_in(10):
            rules.insert(0, ("rt/a*", self._some([("true", "true"), ("false", "false")])))
        if self._one_in(20):
            rules = [("rt/*", control)]
        domains = self._some(["<id>0</id>"] * 20 + ["<id>1</id>"])
        join = self._some(["true"] * 8 + ["false"])
        topic_rules = "".join(
            f"<topic_rule><topic_expression>{expression}</topic_expression>"
            "<enable_discovery_protection>true</enable_discovery_protection>"
            "<enable_liveliness_protection>true</enable_liveliness_protection>"
            f"<enable_read_access_control>{read}</enable_read_access_control>"
            f"<enable_write_access_control>{write}</enable_write_access_control>"
            "<metadata_protection_kind>ENCRYPT</metadata_protection_kind>"
            "<data_protection_kind>ENCRYPT</data_protection_kind></topic_rule>"
            for expression, (read, write) in rules
        )
        return (
            '<?xml version="1.0" encoding="UTF-8"?>\n<dds><domain_access_rules><domain_rule>'
            f"<domains>{domains}</domains>"
            "<allow_unauthenticated_participants>false</allow_unauthenticated_participants>"
            f"<enable_join_access_control>{join}</enable_join_access_control>"
            "<discovery_protection_kind>ENCRYPT</discovery_protection_kind>"
            "<liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>"
            "<rtps_protection_kind>SIGN</rtps_protection_kind>"
            f"<topic_access_rules>{topic_rules}</topic_access_rules>"
            "</domain_rule></domain_access_rules></dds>\n"
        )

    def requests(self, subject: str, count: int) -> list[Edge]:
        """Return ``count`` different requests, in domain 0."""
        requests: set[Edge] = set()
        while len(requests) < count:
            action = self._some(["publish", "subscribe"])
            requests.add(Edge(subject, action, Object("topic", self._some(_TOPICS), self._some(_REQUESTED))))
        return sorted(requests)

    def _grant(self, number: int) -> str:
        begin, end = self._validity()
        default = self._some(["<default>DENY</default>"] * 20 + ["<default>ALLOW</default>"] * 6 + [""])
        name = "" if self._one_in(80) else f' name="grant {number}"'
        rules = "".join(self._rule() for _ in range(self._some([0, 1, 1, 2, 2, 3, 3, 4, 5])))
        return (
            f"<grant{name}><subject_name>{escape(self._some(_SUBJECTS))}</subject_name>"
            f"<validity><not_before>{begin}</not_before><not_after>{end}</not_after></validity>"
            f"{rules}{default}</grant>\n"
        )

    def _validity(self) -> tuple[str, str]:
        zone = self._some([""] * 10 + ["Z", "+05:00", "-05:00"])
        begin, end = self._some([(-1, 900)] * 14 + [(-900, -30), (30, 900), (-900, 1), (-1, 80_000_000)])
        hours = [timedelta(hours=begin), timedelta(hours=min(end, 60_000_000))]
        if self._one_in(12):
            hours = [timedelta(hours=self._some([-2, 2])), timedelta(hours=self._some([900, 3]))]
        return (f"{self._now + hours[0]:%Y-%m-%dT%H:%M:%S}{zone}", f"{self._now + hours[1]:%Y-%m-%dT%H:%M:%S}{zone}")

    def _rule(self) -> str:
        effect = self._some(["allow", "allow", "deny"])
        criteria = "".join(
            self._criteria(action)
            for action, most in (("publish", 2), ("subscribe", 2), ("relay", 1))
            for _ in range(self._some([0, 0, *range(1, most + 1)]))
        )
        domains = "<id>250</id>" if self._one_in(200) else self._some(_DOMAINS)
        return f"<{effect}_rule><domains>{domains}</domains>{criteria}</{effect}_rule>\n"

    def _criteria(self, action: str) -> str:
        topics = "".join(
            f"<topic>{escape(self._some(self._some([_TOPICS, _TOPICS, _PATTERNS, _PATTERNS, self._odd()])))}</topic>"
            for _ in range(self._some([1, 1, 2, 3]))
        )
        listed_partitions = self._some(_LISTS)
        partitions = ""
        if listed_partitions is not None:
            partitions = "".join(f"<partition>{each}</partition>" for each in listed_partitions)
            partitions = f"<partitions>{partitions}</partitions>"
        elif self._one_in(60):
            partitions = "<partitions/>"
        tags = "<data_tags><tag><name>n</name><value>v</value></tag></data_tags>" if self._one_in(40) else ""
        return f"\n<{action}><topics>{topics}</topics>{partitions}{tags}</{action}>"

    def _odd(self) -> list[str]:
        return _ODD_PATTERNS if self._one_in(3) else _TOPICS

    def _one_in(self, number: int) -> bool:
        return self._random.randrange(number) == 0

    def _some(self, values: Sequence[_T]) -> _T:
        return self._random.choice(values)
