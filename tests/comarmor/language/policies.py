# SPDX-License-Identifier: Apache-2.0
"""Texts of policies, made of their elements."""

from __future__ import annotations

import comarmor

XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'


def include(href: str) -> str:
    return f'<xi:include href="{href}" parse="xml"/>'


def tunable(name: str, *values: str) -> str:
    return f'<tunable name="{name}">{"".join(f"<value>{value}</value>" for value in values)}</tunable>'


def allow(*attachments: str) -> str:
    listed = "".join(f"<attachment>{attachment}</attachment>" for attachment in attachments)
    return f'<ros_topic qualifier="ALLOW">{listed}<permissions><ros_publish/></permissions></ros_topic>'


def profile(*content: str, attachment: str = "/s", attributes: str = "") -> str:
    return f'<profile name="p" {XI}{attributes}><attachment>{attachment}</attachment>{"".join(content)}</profile>'


def profiles(*content: str) -> str:
    return f"<profiles {XI}>{''.join(content)}</profiles>"


def topics(policy: comarmor.Policy, subject: str = "/s") -> list[str]:
    return [expression for rule in policy.rules(subject) for expression in rule.expressions]


def rule(kind, effect, attachment, *permissions, partitions=None, modifier=""):
    held = "".join(f"<{permission}/>" for permission in permissions)
    parts = "" if partitions is None else "".join(f"<partition>{item}</partition>" for item in partitions)
    listed = f"<partitions>{parts}</partitions>" if parts else ""
    return (
        f'<{kind} qualifier="{effect}"{modifier}><attachment>{attachment}</attachment>'
        f"<permissions>{held}</permissions>{listed}</{kind}>"
    )
