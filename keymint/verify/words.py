"""Requests and findings in words."""

from __future__ import annotations

from keymint.graph import Edge
from keymint.verify.model import Finding


def request(edge: Edge) -> str:
    """Return an edge in the notation of the command line: ``/talker ros_publish /chatter``."""
    shown = f"{edge.subject} {edge.permission} {edge.object.name}"
    return shown + "".join(f" in partition {name!r}" for name in edge.object.partitions)


def in_words(transport: str, finding: Finding) -> str:
    """Return a finding on one line: the edge, both labels, and why each is so."""
    policy, verdict = finding.policy, finding.verdict
    line = f":{finding.document.line}" if finding.document.line else ""
    said = ", by a model of it," if finding.model else ""
    why = [
        f"{finding.error}: {request(finding.edge)}: the policy {_does(policy.allowed)} it ({policy.reason})",
        f"{transport}{said} {_does(verdict.allowed)} it "
        f"({verdict.reason or 'no reason given'}; {finding.document.file}{line})",
    ]
    if verdict.deviation:
        why.append(f"it deviates from the standard: {verdict.deviation}")
    return ", but ".join(why[:2]) + "".join(f"; {more}" for more in why[2:])


def _does(allowed: bool) -> str:
    return "allows" if allowed else "denies"
