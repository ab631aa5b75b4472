# SPDX-License-Identifier: Apache-2.0
"""Permissions documents, written plainly."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import UTC, datetime
from xml.sax.saxutils import escape

from keymint_ros2_dds.decision.evaluator import DocumentEvaluator
from keymint_ros2_dds.decision.semantics import OMG, Variation
from keymint_ros2_dds.reading.signed_permissions import PermissionsDocument

from keymint.api import Verdict

NOW = datetime(2026, 11, 21, tzinfo=UTC)
SUBJECT = "CN=/talker,OU=4f"


def decide(
    document: PermissionsDocument,
    subject_name: str,
    now: datetime,
    domain: int,
    action: str,
    topic: str,
    partitions: Sequence[str] = (),
    tags: Collection[tuple[str, str]] = (),
    variation: Variation = OMG,
) -> Verdict:
    """Decide about one endpoint by a document."""
    return DocumentEvaluator(document, subject_name, now, domain, variation).decide(action, topic, partitions, tags)


def criteria(action: str, *topics: str, partitions: tuple[str, ...] | None = None, tags: str = "") -> str:
    listed = "".join(f"<topic>{escape(topic)}</topic>" for topic in topics)
    narrowed = "" if partitions is None else "".join(f"<partition>{escape(each)}</partition>" for each in partitions)
    narrowed = "" if partitions is None else f"<partitions>{narrowed}</partitions>"
    tagged = f"<data_tags><tag><name>{tags}</name><value>v</value></tag></data_tags>" if tags else ""
    return f"\n<{action}><topics>{listed}</topics>{narrowed}{tagged}</{action}>"


def rule(effect: str, *bodies: str, domains: str = "<id>0</id>") -> str:
    return f"\n<{effect}_rule><domains>{domains}</domains>{''.join(bodies)}</{effect}_rule>"


def grant(
    *rules: str,
    subject: str = SUBJECT,
    validity: tuple[str, str] = ("2026-01-01T00:00:00", "2027-01-01T00:00:00"),
    default: str = "DENY",
    name: str = ' name="g"',
) -> str:
    dates = f"<validity><not_before>{validity[0]}</not_before><not_after>{validity[1]}</not_after></validity>"
    ending = f"<default>{default}</default>" if default else ""
    return f"\n<grant{name}><subject_name>{escape(subject)}</subject_name>{dates}{''.join(rules)}{ending}</grant>"


def document(*grants: str) -> bytes:
    return f"<dds><permissions>{''.join(grants)}</permissions></dds>".encode()


PLAIN = document(
    grant(
        rule("allow", criteria("publish", "rt/x", "rt/y"), criteria("subscribe", "rt/s", partitions=("a",))),
        rule("deny", criteria("publish", "rt/*", tags="t")),
        rule("allow", domains="<id_range><min>0</min><max>7</max></id_range>"),
    )
)
