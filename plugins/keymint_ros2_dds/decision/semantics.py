"""The points on which implementations of DDS Security differ, and how each of them sees them.

Every point is a field of :class:`Semantics`, whose defaults are the standard's. A :class:`Deviation` changes a point,
and a :class:`Variation` is a list of deviations: an implementation. The rows are those of the table in
``docs/vendors.md``, which was measured on Cyclone DDS 0.10.2 and Fast DDS 2.9.1.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from comarmor.patterns.tokens import Dialect
from keymint_ros2_dds.decision import fnmatch, strictness, subject_names
from keymint_ros2_dds.decision.strictness import Parser
from keymint_ros2_dds.reading import dates
from keymint_ros2_dds.reading.quirks import BLANKS
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import (
    DocumentGrant,
    PermissionsDocument,
)


def trimmed(text: str) -> str:
    """Cyclone DDS: white space around a text is no part of it."""
    return text.strip(BLANKS)


def unless_blank(text: str) -> str:
    """Fast DDS: white space alone is no text."""
    return text if text.strip(BLANKS) else ""


BEGINNING_OF_TIME = datetime.min.replace(tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Semantics:
    """How a permissions document is read.

    Attributes:
        parser: whose parser reads the documents; it decides which documents are refused, and which are not modelled.
        selects: whether a grant's subject name is about an identity: both as text, ``CN=/talker,OU=h``.
        passes_over_invalid: a grant that is not valid now is passed over; else it ends the search.
        date: reads a date of the document; None is none: it never holds.
        no_beginning_holds: a beginning that is no date has passed.
        reads_text: returns an expression, or a subject name, as it is read.
        default_counts: ``<default>`` is looked at; else it is always DENY.
        min_only_is_exact: a range of domains with ``min`` alone is that domain; else every higher one as well.
        domains_count: rules of other domains are passed over.
        fnmatch: the dialect of expressions.
        pools_criteria: topics and partitions of all criteria of a rule are taken together.
        first_topic_decides: a rule that names the topic ends the search, also if its partitions do not match.
        deny_default: a deny rule without partitions is about the default partition alone; else about every partition.
        deny_topic: the partitions of a deny rule do not matter.
        topic_check: the first criteria that name the topic, in any direction, decide whether there is a topic at all.
        tags_count: data tags are looked at.
        needs_rule_to_join: a participant needs a rule that allows something, whatever the governance document says.
        topic_rules_both_ways: the name of a topic is taken for an expression about those of topic rules, too.
    """

    parser: Parser = Parser.STANDARD
    selects: Callable[[str, str], bool] = subject_names.same_name
    passes_over_invalid: bool = True
    date: Callable[[str], datetime | None] = dates.standard
    no_beginning_holds: bool = False
    reads_text: Callable[[str], str] = str
    default_counts: bool = True
    min_only_is_exact: bool = False
    domains_count: bool = True
    fnmatch: Dialect = fnmatch.STANDARD
    pools_criteria: bool = False
    first_topic_decides: bool = False
    deny_default: bool = False
    deny_topic: bool = False
    topic_check: bool = False
    tags_count: bool = True
    needs_rule_to_join: bool = False
    topic_rules_both_ways: bool = False

    def refusal(self, document: PermissionsDocument | GovernanceDocument) -> str:
        """Return why the parser refuses a document, or an empty text."""
        return strictness.refusal(document, self.parser)

    def unmodelled(self, document: PermissionsDocument | GovernanceDocument) -> str:
        """Return why it is not known how the parser reads a document, or an empty text."""
        return strictness.unmodelled(document, self.parser)

    def grants(self, document: PermissionsDocument, subject_name: str) -> Sequence[DocumentGrant]:
        """Return the grants that are about an identity, in the order of the document."""
        return [each for each in document.grants if self.selects(self.reads_text(each.subject_name), subject_name)]

    def period(self, grant: DocumentGrant) -> tuple[datetime, datetime] | None:
        """Return when a grant is valid, both ends included; None is never."""
        begin, end = self.date(grant.not_before), self.date(grant.not_after)
        if begin is None and self.no_beginning_holds:
            begin = BEGINNING_OF_TIME
        return None if begin is None or end is None or begin > end else (begin, end)


STANDARD = Semantics()


@dataclass(frozen=True, slots=True)
class Deviation:
    """One point on which an implementation differs from the standard.

    Attributes:
        row: row of the table of disagreements.
        name: in kebab-case.
        text: one line for people.
        changes: fields of :class:`Semantics`.
    """

    row: str
    name: str
    text: str
    changes: Mapping[str, Any] = field(repr=False)

    def __str__(self) -> str:
        """Return what a report says: row, name and text."""
        return f"row {self.row}, {self.name}: {self.text}"


@dataclass(frozen=True, slots=True)
class Variation:
    """An implementation: the standard with deviations.

    Attributes:
        name: e.g. ``cyclonedds-0.10``; tells variations apart.
        deviations: in the order of their rows.
    """

    name: str
    deviations: tuple[Deviation, ...] = ()

    @property
    def semantics(self) -> Semantics:
        """The points with all deviations applied."""
        return functools.reduce(lambda found, deviation: replace(found, **deviation.changes), self.deviations, STANDARD)

    def without(self, deviation: Deviation) -> Variation:
        """Return the implementation if it did not differ on one point."""
        left = tuple(item for item in self.deviations if item != deviation)
        return Variation(f"{self.name} without {deviation.name}", left)

    def only(self, deviation: Deviation) -> Variation:
        """Return the implementation if it differed on one point alone."""
        return Variation(f"{self.name} with {deviation.name} alone", (deviation,))


def _on(row: str, name: str, text: str, **changes: Any) -> Deviation:
    return Deviation(row, name, text, changes)


CYCLONE_DEVIATIONS = (
    _on("1", "subject-tokens", "every part of the identity's name must occur in the grant's, in any order",
        selects=subject_names.parts_occur),
    _on("2", "first-grant-only", "the first grant of the subject counts, also when it is not valid now",
        passes_over_invalid=False),
    _on("6", "deny-default-partition", "a deny rule without partitions is about the default partition alone",
        deny_default=True),
    _on("9", "topic-check", "the first rule that names a topic decides whether it exists, whatever its direction",
        topic_check=True),
    _on("11", "strictness", "domain ids above 230, foreign attributes, and what is without its ends are refused",
        parser=Parser.CYCLONE),
    _on("12", "min-only", "a range of domains with a minimum alone is that one domain", min_only_is_exact=True),
    _on("15", "late-dates", "a date that does not fit 64 bits of nanoseconds, or is none, is over",
        date=dates.cyclone, no_beginning_holds=True),
    _on("16", "trimmed-text", "white space around a text is no part of it", reads_text=trimmed),
    _on("17", "fnmatch", "no escapes; only '!' negates a set; the ']' that ends a set is a member of it",
        fnmatch=fnmatch.CYCLONE_DDS),
    _on("data tags", "tags-ignored", "data tags are not looked at", tags_count=False),
)  # fmt: skip

FAST_DEVIATIONS = (
    _on("1", "subject-text", "names are compared as text in the order of RFC 2253, blanks around parts aside",
        selects=subject_names.same_text),
    _on("3", "default-unused", "<default>ALLOW</default> is read and never used", default_counts=False),
    _on("4", "pooled-criteria", "topics and partitions of all criteria of a rule are taken together",
        pools_criteria=True),
    _on("5", "first-topic-decides", "a rule that names the topic ends the search, also if its partitions do not match",
        first_topic_decides=True),
    _on("7", "deny-topic", "a deny rule denies the topic in every partition, also if it lists some", deny_topic=True),
    _on("10", "domains-unused", "rules of other domains count as well in local checks", domains_count=False),
    _on("11", "strictness", "a grant without a name or default, and empty lists, are refused",
        parser=Parser.FAST),
    _on("12", "min-only", "a range of domains with a minimum alone is that one domain", min_only_is_exact=True),
    _on("14", "zone-ignored", "the zone of a date is ignored", date=dates.fast),
    _on("16", "blank-text", "a text of white space alone is empty", reads_text=unless_blank),
    _on("17", "fnmatch", "expressions have no escapes", fnmatch=fnmatch.FAST_DDS),
    _on("19", "rule-to-join", "a participant needs an allow_rule, also where joining is not controlled",
        needs_rule_to_join=True),
    _on("20", "topic-rules-both-ways",
        "the name of a topic is compared as an expression with the expressions of the governance, too",
        topic_rules_both_ways=True),
    _on("data tags", "tags-ignored", "data tags are not looked at", tags_count=False),
)  # fmt: skip

OMG = Variation("omg")
CYCLONEDDS_0_10 = Variation("cyclonedds-0.10", CYCLONE_DEVIATIONS)
FASTDDS_2_9 = Variation("fastdds-2.9", FAST_DEVIATIONS)
VARIATIONS: Mapping[str, Variation] = {each.name: each for each in (OMG, CYCLONEDDS_0_10, FASTDDS_2_9)}
