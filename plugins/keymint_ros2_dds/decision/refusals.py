"""Why an implementation refuses a permissions document as a whole; an empty text if it does not."""

from __future__ import annotations

from collections.abc import Iterator

from keymint_ros2_dds.decision.document import Domains, PermissionsDocument, Rule
from keymint_ros2_dds.document import MAX_DOMAIN


def schema_refuses(document: PermissionsDocument) -> str:
    """The standard: what its schema does not allow (DDS Security 1.1, 9.4.1.3)."""
    return f"the schema refuses it: {document.defects[0]}" if document.defects else ""


def stops_cyclone(document: PermissionsDocument) -> str:
    """Return what ends the process of Cyclone DDS 0.10 that reads the document, as a reason not to give it."""
    for rule in _rules(document):
        if not rule.domains:
            return f"line {rule.line}: a rule without domains stops Cyclone DDS"
        if any(item.first is None for item in rule.domains):
            return f"line {rule.line}: a range of domains without a minimum stops Cyclone DDS"
        if any(not topic.strip() for item in rule.criteria for topic in item.topics):
            return f"line {rule.line}: an empty topic stops Cyclone DDS"
    return ""


def cyclone_refuses(document: PermissionsDocument) -> str:
    """Cyclone DDS 0.10: domain ids without ports; and what it cannot read to the end."""
    for rule in _rules(document):
        if any(max(item.first or 0, item.last or 0) > MAX_DOMAIN for item in rule.domains):
            return f"line {rule.line}: Cyclone DDS refuses a domain id above {MAX_DOMAIN}"
    return stops_cyclone(document)


def fast_refuses(document: PermissionsDocument) -> str:
    """Fast DDS 2.9: a grant without name or default, and lists without members."""
    for grant in document.grants:
        if grant.name is None:
            return f"line {grant.line}: Fast DDS refuses a grant without a name"
        if grant.default is None:
            return f"line {grant.line}: Fast DDS refuses a grant without a default"
    for rule in _rules(document):
        if not rule.domains:
            return f"line {rule.line}: Fast DDS refuses a rule without domains"
        for item in rule.criteria:
            if not item.topics or not all(item.topics) or item.partitions == ():
                return f"line {item.line}: Fast DDS refuses an empty list"
    return ""


def covers(domains: Domains, domain: int, *, min_only_is_exact: bool) -> bool:
    """Tell whether a domain id lies in a range."""
    first = domains.first or 0
    last = domains.last
    if last is None:
        return domain == first if min_only_is_exact else domain >= first
    return first <= domain <= last


def _rules(document: PermissionsDocument) -> Iterator[Rule]:
    return (rule for grant in document.grants for rule in grant.rules)
