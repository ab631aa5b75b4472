"""Permissions documents, written plainly."""

from __future__ import annotations

from datetime import UTC, datetime
from xml.sax.saxutils import escape

NOW = datetime(2026, 11, 21, tzinfo=UTC)
SUBJECT = "CN=/talker,OU=4f"


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
