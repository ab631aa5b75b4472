"""Requests, rules and findings in words."""

from __future__ import annotations

import re
from collections.abc import Sequence

from keymint.graph import Edge
from keymint.ir import Rule
from keymint.verify.mismatch import Mismatch

_MOST = 4
_PLACE = re.compile(r"^[\w.]+\.(xml|p7s)(:\d+)?: ")


def request(edge: Edge) -> str:
    """Return an edge in the notation of the command line: ``/talker ros_publish /chatter``."""
    shown = f"{edge.subject} {edge.permission} {edge.object.name}"
    return shown + "".join(f" in partition {name!r}" for name in edge.object.partitions)


def in_words(transports: Sequence[str], finding: Mismatch, *, here: bool = False) -> str:
    """Return a finding on one line: the edge, both labels, and why each is so.

    Args:
        transports: names of the transports that decide so.
        finding: the finding.
        here: the line is told at the rule of the policy, if there is one.
    """
    policy, verdict = finding.policy, finding.verdict
    by_policy = "by this rule" if here and policy.where else policy.reason
    return (
        f"{finding.error}: {request(finding.edge)}: the policy {does(policy.allowed)} it ({by_policy}), "
        f"but {listed(transports)} {does(verdict.allowed, many=len(transports) > 1)} it ({of_document(finding)})"
    )


def of_document(finding: Mismatch) -> str:
    """Return what the enclave's document says on an edge, where, and which deviation explains it."""
    document, deviation = finding.document, finding.verdict.deviation
    place = document.file + (f":{document.line}" if document.line else "")
    deviates = f"; deviates from the standard: {deviation}" if deviation else ""
    return f"{place}: {plain(finding.reason) or 'no reason is given'}{deviates}"


def plain(reason: str) -> str:
    """Return a transport's reason without the place that it begins with."""
    return _PLACE.sub("", reason)


def does(allowed: bool, *, many: bool = False) -> str:
    """Return the verb of a decision."""
    return ("allow" if allowed else "deny") if many else ("allows" if allowed else "denies")


def listed(names: Sequence[str]) -> str:
    """Return names as in a sentence: ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def in_words_of_rule(rule: Rule) -> str:
    """Return a rule on one line: ``ALLOW ros_topic ros_publish of '/a', '/b' and 3 more``."""
    names = [repr(each) for each in rule.expressions[:_MOST]]
    more = len(rule.expressions) - len(names)
    partitions = f" in partitions {', '.join(map(repr, rule.partitions))}" if rule.partitions else ""
    audit = " (AUDIT)" if rule.audit else ""
    shown = ", ".join(names) + (f" and {more} more" if more else "")
    return f"{rule.effect} {rule.kind} {'+'.join(rule.permissions)} of {shown}{partitions}{audit}"
