# SPDX-License-Identifier: Apache-2.0
"""The points on which implementations of DDS Security differ from the standard.

Each point is a field of :class:`Semantics`; the defaults are the standard's. A :class:`Deviation` changes fields, and a
:class:`Variation` is an implementation: a list of deviations. The rows are those of the table in ``docs/vendors.md``,
and :attr:`Variation.evidence` says which were measured. What else depends on the version follows from the
:class:`Variation`: the assumptions of proofs, the claims for a distribution, and the simulated transport.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Literal

from comarmor.patterns.tokens import Dialect
from comarmor.values import Data, field, replace
from keymint_ros2_dds import subject_names
from keymint_ros2_dds.lowering.name_mapping import DISTROS
from keymint_ros2_dds.reading import dialects
from keymint_ros2_dds.reading.dialects import BLANKS, CRASHES, REFUSES, UNMODELLED, Quirk, VendorReading
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, DocumentRule, PermissionsDocument


def trim_blanks(text: str) -> str:
    """Return a text as Cyclone DDS reads it: without the white space around it."""
    return text.strip(BLANKS)


def unless_blank(text: str) -> str:
    """Return a text as Fast DDS reads it: white space alone is an empty text."""
    return text if text.strip(BLANKS) else ""


Parser = Literal["the schema", "Cyclone DDS", "Fast DDS"]
"""Whose parser reads a document: the standard accepts what its schema allows (DDS Security 1.1, 9.4.1)."""
TopicCheck = Literal["", "first", "either"]
"""Which criteria decide whether a topic may be created, whatever the partitions; the standard asks endpoints only.

``first``: the first ones that match it, in any direction. ``either``: the first ones that match it for publishing, or
those for subscribing, allow it.
"""
Evidence = Literal["specified", "measured", "from sources"]
"""How the semantics of an implementation are known."""
BEGINNING_OF_TIME = datetime.min.replace(tzinfo=UTC)


class Semantics(Data):
    """How the files of an enclave are read.

    Attributes:
        parser: whose parser reads the documents; it decides which documents are refused, and which are not modelled.
        selects: tells whether a grant's subject name matches an identity's; both are text, ``CN=/talker,OU=h``.
        passes_over_invalid: a grant that is not valid now is skipped; else it ends the search.
        date: reads a date of the document; returns None if it cannot, and then the grant is never valid.
        no_beginning_holds: a ``not_before`` that cannot be read counts as past.
        reads_text: returns an expression, or a subject name, as it is read.
        default_counts: ``<default>`` is evaluated; else it is always DENY.
        min_only_is_exact: a range of domains with ``min`` alone is that domain; else every higher one as well.
        domains_count: rules of other domains are skipped.
        fnmatch: the dialect of expressions.
        pools_criteria: topics and partitions of all criteria of a rule are taken together.
        first_topic_decides: a rule that names the topic ends the search, also if its partitions do not match.
        deny_default: a deny rule without partitions applies to the default partition only; else to every partition.
        deny_topic: the partitions of a deny rule do not matter.
        topic_check: what decides whether the topic may be created.
        tags_count: data tags are evaluated.
        needs_rule_to_join: a participant needs an allow rule, even if the governance does not control joining.
        topic_rules_both_ways: a topic rule also matches if the topic's name, as a pattern, matches its expression.
        one_authority: only the first certificate of the identity authority's file is trusted.
        lists_among_authorities: revocation lists in the identity authority's file are read.
        keys_in_tokens: a private key may be the URI of one in a token (DDS Security 1.1, 9.3.1).
    """

    parser: Parser = "the schema"
    selects: Callable[[str, str], bool] = subject_names.same_name
    passes_over_invalid: bool = True
    date: Callable[[str], datetime | None] = dialects.standard_date
    no_beginning_holds: bool = False
    reads_text: Callable[[str], str] = str
    default_counts: bool = True
    min_only_is_exact: bool = False
    domains_count: bool = True
    fnmatch: Dialect = dialects.STANDARD
    pools_criteria: bool = False
    first_topic_decides: bool = False
    deny_default: bool = False
    deny_topic: bool = False
    topic_check: TopicCheck = ""
    tags_count: bool = True
    needs_rule_to_join: bool = False
    topic_rules_both_ways: bool = False
    one_authority: bool = False
    lists_among_authorities: bool = False
    keys_in_tokens: bool = True

    @property
    def bounds(self) -> tuple[Semantics, ...]:
        """Semantics between which these lie where lists that must all permit cannot express them; else these alone.

        Decision lists of ``either`` are those of one direction, which permit too little: without the check too much.
        """
        return (self, replace(self, topic_check="")) if self.topic_check == "either" else (self,)

    def refusal(self, document: PermissionsDocument | GovernanceDocument) -> str:
        """Return why the parser refuses a document, in one line with its place; or an empty text."""
        if self.parser == "the schema":
            return document.defect
        quirk = self._first(document, CRASHES, REFUSES)
        if quirk is None or self.unmodelled(document):
            return ""
        crashes = self._reading(quirk) == CRASHES
        text = f"{quirk.text} crashes {self.parser}" if crashes else f"{self.parser} refuses {quirk.text}"
        return f"{document.place(quirk.line)}: {text}"

    def unmodelled(self, document: PermissionsDocument | GovernanceDocument) -> str:
        """Return why it is not known how the parser reads a document, or an empty text."""
        quirk = None if self.parser == "the schema" else self._first(document, UNMODELLED)
        return f"{document.place(quirk.line)}: how {self.parser} reads {quirk.text} is not modelled" if quirk else ""

    def _first(self, document: PermissionsDocument | GovernanceDocument, *readings: VendorReading) -> Quirk | None:
        return next((quirk for quirk in document.quirks if self._reading(quirk) in readings), None)

    def _reading(self, quirk: Quirk) -> VendorReading:
        return quirk.cyclone if self.parser == "Cyclone DDS" else quirk.fast

    def grants(self, document: PermissionsDocument, subject_name: str) -> Sequence[DocumentGrant]:
        """Return the grants that may apply to an identity, in the order of the document."""
        grants = [grant for grant in document.grants if self.selects(self.reads_text(grant.subject_name), subject_name)]
        return grants if self.passes_over_invalid else grants[:1]

    def applies(self, rule: DocumentRule, domain: int) -> bool:
        """Return whether a rule applies in a domain."""
        exact = self.min_only_is_exact
        return not self.domains_count or any(each.contain(domain, min_only_is_exact=exact) for each in rule.domains)

    def period(self, grant: DocumentGrant) -> tuple[datetime, datetime] | None:
        """Return the period of validity of a grant, both ends included; None if it is never valid."""
        begin, end = self.date(grant.not_before), self.date(grant.not_after)
        if begin is None and self.no_beginning_holds:
            begin = BEGINNING_OF_TIME
        return None if begin is None or end is None or begin > end else (begin, end)


STANDARD = Semantics()


class Deviation(Data):
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
    changes: Mapping[str, Any] = field(repr=False, compare=False)

    def __str__(self) -> str:
        """Return row, name and text, as reports show them."""
        return f"row {self.row}, {self.name}: {self.text}"


class Variation(Data, slots=False):
    """An implementation, from one version on: the standard with deviations.

    Attributes:
        name: e.g. ``cyclonedds-0.10``; unique. A simulated transport has this name.
        deviations: in the order of their rows.
        vendor: as :data:`keymint_ros2_dds.lowering.name_mapping.DISTROS` names it; empty for the standard.
        since: the first version that the semantics are for; the oldest one stands for all earlier versions too.
        evidence: how they are known.
        reading: how documents are read, in words; the first assumption of each proof.
        assumptions: what else proofs assume about it.
        any_signer: a document counts if the permissions authority certified its signer as anybody (CVE-2023-24010).
    """

    name: str
    deviations: tuple[Deviation, ...] = ()
    vendor: str = ""
    since: tuple[int, ...] = ()
    evidence: Evidence = "specified"
    reading: str = ""
    assumptions: tuple[str, ...] = ()
    any_signer: bool = False

    @functools.cached_property
    def semantics(self) -> Semantics:
        """The standard's semantics with all deviations applied."""
        return _semantics(self.deviations)

    def without(self, deviation: Deviation) -> Variation:
        """Return the implementation without one deviation."""
        left = tuple(item for item in self.deviations if item != deviation)
        return Variation(f"{self.name} without {deviation.name}", left)

    def only(self, deviation: Deviation) -> Variation:
        """Return the standard with one deviation alone."""
        return Variation(f"{self.name} with {deviation.name} alone", (deviation,))


@functools.lru_cache(maxsize=64)
def _semantics(deviations: tuple[Deviation, ...]) -> Semantics:
    """Return one object for the same deviations, so that models share what depends on it."""
    changes = {name: value for deviation in deviations for name, value in deviation.changes.items()}
    return replace(STANDARD, **changes)


def _on(row: str, name: str, text: str, **changes: Any) -> Deviation:
    return Deviation(row, name, text, changes)


CYCLONE_DEVIATIONS = (
    _on("1", "subject-tokens", "every part of the identity's name must occur in the grant's, in any order",
        selects=subject_names.parts_occur),
    _on("2", "first-grant-only", "the first grant of the subject applies, even if it is not valid now",
        passes_over_invalid=False),
    _on("6", "deny-default-partition", "a deny rule without partitions applies to the default partition only",
        deny_default=True),
    _on("9", "topic-check", "the first rule that names a topic decides whether it exists, whatever its direction",
        topic_check="first"),
    _on("11", "strictness", "domain ids above 230, foreign attributes, and incomplete ranges are refused",
        parser="Cyclone DDS"),
    _on("12", "min-only", "a range of domains with a minimum alone is that one domain", min_only_is_exact=True),
    _on("15", "late-dates", "a date that does not fit 64 bits of nanoseconds, or is none, is over",
        date=dialects.cyclone_date, no_beginning_holds=True),
    _on("16", "trimmed-text", "white space around a text is ignored", reads_text=trim_blanks),
    _on("17", "fnmatch", "no escapes; only '!' negates a set; the ']' that ends a set is a member of it",
        fnmatch=dialects.CYCLONE_DDS),
    _on("21", "one-authority", "only the first certificate of identity_ca.cert.pem is trusted", one_authority=True),
    _on("23", "no-keys-in-tokens", "key.p11 is not read, and key.pem is missing", keys_in_tokens=False),
    _on("data tags", "tags-ignored", "data tags are ignored", tags_count=False),
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
        parser="Fast DDS"),
    _on("12", "min-only", "a range of domains with a minimum alone is that one domain", min_only_is_exact=True),
    _on("14", "zone-ignored", "the zone of a date is ignored", date=dialects.fast_date),
    _on("16", "blank-text", "a text of white space alone is empty", reads_text=unless_blank),
    _on("17", "fnmatch", "expressions have no escapes", fnmatch=dialects.FAST_DDS),
    _on("19", "rule-to-join", "a participant needs an allow_rule, even if joining is not controlled",
        needs_rule_to_join=True),
    _on("20", "topic-rules-both-ways",
        "the name of a topic is compared as an expression with the expressions of the governance, too",
        topic_rules_both_ways=True),
    _on("22", "lists-among-authorities", "revocation lists in identity_ca.cert.pem are read",
        lists_among_authorities=True),
    _on("data tags", "tags-ignored", "data tags are ignored", tags_count=False),
)  # fmt: skip

_OF_CYCLONE_11 = {
    "1": _on("1", "trimmed-subject-tokens", "as in 0.10, but blanks around the parts of a name do not count",
        selects=subject_names.trimmed_parts_occur),
    "9": _on("9", "topic-check-either", "a topic exists if publishing or subscribing is allowed by its first rule",
        topic_check="either"),
}  # fmt: skip
CYCLONE_11_DEVIATIONS = tuple(_OF_CYCLONE_11.get(each.row, each) for each in CYCLONE_DEVIATIONS)
FAST_2_11_DEVIATIONS = (
    _on("1", "subject-attributes", "names are compared by their attributes in any order, blanks and quotes aside",
        selects=subject_names.same_attributes),
    *FAST_DEVIATIONS[1:],
)  # fmt: skip

_OF_CYCLONE = ("no application creates built-in topics (DCPS…): Cyclone DDS does not check these",)
_OF_FAST = (
    "non-ASCII names are compared by byte (C locale); other locales (Python sets one) also compare characters",
    "participants join only the domains of the policy: local checks ignore the domains in permissions",
    "the local time zone is UTC: Fast DDS reads the dates of a grant as local time",
)

OMG = Variation("omg", reading="documents are read as DDS Security 1.1 specifies (9.4.1.3)")
CYCLONEDDS_0_10 = Variation(
    "cyclonedds-0.10", CYCLONE_DEVIATIONS, "cyclonedds", (0, 7), "measured",
    "documents are read as Cyclone DDS 0.10.2 and 0.10.5 were measured to; the topic check is part of the model",
    _OF_CYCLONE, any_signer=True,
)  # fmt: skip
CYCLONEDDS_11 = Variation(
    "cyclonedds-11", CYCLONE_11_DEVIATIONS, "cyclonedds", (11,), "from sources",
    "documents are read as sources of Cyclone DDS 11.0.1 do, not run; the topic check is part of the model",
    _OF_CYCLONE,
)  # fmt: skip
FASTDDS_2_9 = Variation(
    "fastdds-2.9", FAST_DEVIATIONS, "fastdds", (2, 0), "measured",
    "documents are read as Fast DDS 2.9.1 was measured to read them", _OF_FAST, any_signer=True,
)  # fmt: skip
FASTDDS_2_11 = Variation(
    "fastdds-2.11", FAST_2_11_DEVIATIONS, "fastdds", (2, 11), "from sources",
    "names are compared as sources of Fast DDS 2.11.0 to 2.14.6 do, not run; all else as measured on 2.9.1",
    _OF_FAST,
)  # fmt: skip
FASTDDS_3_3 = Variation(
    "fastdds-3.3", FAST_2_11_DEVIATIONS, "fastdds", (3, 0), "measured",
    "documents are read as Fast DDS 3.3.0 was measured to read them", _OF_FAST,
)  # fmt: skip
VARIATIONS: Mapping[str, Variation] = {
    each.name: each for each in (OMG, CYCLONEDDS_0_10, CYCLONEDDS_11, FASTDDS_2_9, FASTDDS_2_11, FASTDDS_3_3)
}
"""All models: the standard first, then each vendor's, the oldest first."""


def of_version(vendor: str, version: str) -> Variation:
    """Return the model of a version of a vendor, e.g. ``2.14.1``: the latest one that is not newer, else the oldest."""
    number = tuple(map(int, version.split("."))) if version else ()
    own = [each for each in VARIATIONS.values() if each.vendor == vendor]
    return next((each for each in reversed(own) if each.since <= number), own[0])


@functools.cache
def shipped_models(distro: str) -> tuple[str, ...]:
    """Return the names of the models that claims are made for: the standard, and one for each vendor.

    It is the version that the distribution ships; the oldest one of a vendor that it does not ship.
    """
    versions = DISTROS.get(distro, {})
    vendors = dict.fromkeys(each.vendor for each in VARIATIONS.values() if each.vendor)
    return OMG.name, *(of_version(each, versions.get(each, "")).name for each in vendors)


def explain(ask: Callable[[Variation], bool], variation: Variation) -> tuple[Deviation, ...]:
    """Return the deviations for which an implementation decides differently from the standard; empty if it does not.

    Return the deviations that each suffice alone; if there are none, those that are each necessary; else all.

    Args:
        ask: decides the same question by an implementation.
        variation: the implementation.
    """
    expected, decided = ask(OMG), ask(variation)
    if expected == decided:
        return ()
    alone = tuple(item for item in variation.deviations if ask(variation.only(item)) == decided)
    if alone:
        return alone
    needed = tuple(item for item in variation.deviations if ask(variation.without(item)) == expected)
    return needed or variation.deviations
