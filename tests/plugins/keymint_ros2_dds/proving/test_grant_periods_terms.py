# SPDX-License-Identifier: Apache-2.0
"""When a document is in force, as each model reads dates: held against the decision point at that time."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds import enclave_proof
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator
from keymint_ros2_dds.decision.semantics import VARIATIONS
from keymint_ros2_dds.proving.grant_periods import joined_periods, of_grants
from keymint_ros2_dds.reading import signed_permissions

from keymint.api import EnclaveFiles, ValidityTerm
from keymint.errors import KeymintError
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.enclaves import anchors, installed
from tests.plugins.keymint_ros2_dds.packages import package, rule

NAME = "CN=/talker"
DATES = st.sampled_from(
    [
        "2026-01-01T00:00:00", "2026-01-01T00:00:00Z", "2026-01-01T05:00:00+05:00", "2025-12-31T23:59:59",
        "2026-01-01T00:00:00-11:00", "2026-01-01T00:00:00+13:00", "2026-06-01T24:00:00", "2026-02-30T00:00:00",
        "2262-04-12T00:00:00", "2400-01-01T00:00:00", "12026-01-01T00:00:00", "0001-01-01T00:00:00", "today",
        "2026-06-02T00:00:00", "2026-06-01T23:59:59.5",
    ]
)  # fmt: skip
MOMENTS = st.sampled_from(
    [
        datetime(2026, 1, 1, tzinfo=UTC), datetime(2026, 6, 2, tzinfo=UTC), datetime(2026, 3, 2, tzinfo=UTC),
        datetime(2262, 4, 12, tzinfo=UTC), datetime(2300, 1, 1, tzinfo=UTC), datetime(1, 1, 2, tzinfo=UTC),
    ]
)  # fmt: skip
OFFSETS = st.sampled_from([0, 1, -1, 3600 * 5, -3600 * 5, 3600 * 12])


CYCLONE = ("cyclonedds-0.10", "cyclonedds-11")


def grant(first: str, last: str, name: str = NAME, topic: str = "rt/a") -> str:
    return (
        f'<grant name="g"><subject_name>{name}</subject_name><validity><not_before>{first}</not_before>'
        f"<not_after>{last}</not_after></validity><allow_rule><domains><id>0</id></domains><publish><topics>"
        f"<topic>{topic}</topic></topics></publish></allow_rule><default>DENY</default></grant>"
    )


def document(*grants: str) -> bytes:
    return f"<dds>\n<permissions>{chr(10).join(grants)}\n</permissions></dds>".encode()


def terms(content: bytes, name: str = NAME) -> list[ValidityTerm]:
    return list(of_grants(content, ("permissions.p7s", 7), name, tuple(VARIATIONS)))


@settings(max_examples=tries(80, 400))
@given(st.lists(st.tuples(DATES, DATES), min_size=1, max_size=3), st.lists(st.tuples(MOMENTS, OFFSETS), max_size=8))
def test_a_document_is_in_force_exactly_when_the_decision_point_finds_a_grant(dates, moments):
    content = document(*(grant(*each) for each in dates))
    read = signed_permissions.read(content)
    found = {model: term.periods for term in terms(content) for model in term.models}
    for model, variation in VARIATIONS.items():
        semantics = variation.semantics
        if semantics.refusal(read) or semantics.unmodelled(read):
            assert model not in found
            continue
        ends = [end for period in found[model] for end in period]
        for moment, offset in [*moments, *((end, by) for end in ends for by in (0, 1, -1))]:
            try:
                now = moment + timedelta(seconds=offset)
            except OverflowError:
                continue
            in_force = any(first <= now <= last for first, last in found[model])
            assert in_force is (DocumentEvaluator(read, NAME, now, 0, variation).refusal is None), (
                model,
                now,
                found[model],
            )


def test_models_that_agree_have_one_term_with_its_line():
    found = {term.models: term for term in terms(document(grant("2026-01-01T00:00:00", "2400-01-01T00:00:00")))}
    assert found.keys() == {("omg", "fastdds-2.9", "fastdds-2.11", "fastdds-3.3"), CYCLONE}
    assert found[CYCLONE].periods == (), "its time ends in 2262"
    assert {str(term.where) for term in found.values()} == {"permissions.p7s:9"}


def test_a_grant_of_another_subject_has_no_term():
    assert not terms(document(grant("2026-01-01T00:00:00", "2027-01-01T00:00:00", "CN=/x")))


@pytest.mark.parametrize(
    "topic", ["rt/a", "rq/b/cRequest", "", "  ", "a\nb", "*", "&amp;", "&#97;", "<![CDATA[a]]>", "<b/>"]
)
@pytest.mark.parametrize(
    "name", [NAME, "CN=/a/b", "CN=" + "/a" * 19, "CN=" + "/a" * 20, "CN=é", "OU=1,CN=/a", "CN=a b"]
)
@pytest.mark.parametrize("identity", [None, NAME, "CN=/a,OU=1"])
def test_documents_that_are_taken_to_be_alike_have_the_terms_of_a_direct_reading(topic, name, identity):
    content = document(grant("2026-01-01T00:00:00", "2027-01-01T00:00:00", name, topic))
    identity = identity or name
    terms(document(grant("2026-01-01T00:00:00", "2027-01-01T00:00:00")))  # what may be remembered
    read_by_itself = b"<!---->" + content  # a comment before the root changes no reading, and no line
    assert terms(content, identity) == terms(read_by_itself, identity)


def test_terms_of_a_document_that_cannot_be_read_are_an_error_with_its_place():
    with pytest.raises(KeymintError, match=r"permissions\.p7s:9"):
        terms(document(grant("", "") + "&"))


def test_an_enclave_has_a_term_for_its_grant_and_each_of_its_certificates():
    loaded = package(rule("ALLOW", "ros_topic", "ros_publish", "/chatter"))
    files = installed(loaded)
    found = enclave_proof.terms(EnclaveFiles(files, "install/talker", anchors(loaded)))
    assert [(term.code, term.where.file.rpartition("/")[2]) for term in found] == [
        ("grant", "permissions.xml"),
        ("certificate", "cert.pem"),
        ("authority", "identity_ca.cert.pem"),
        ("authority", "permissions_ca.cert.pem"),
    ]
    with pytest.raises(KeymintError, match="missing"):
        enclave_proof.terms(EnclaveFiles({}, "install/talker", anchors(loaded)))


def day(number: int) -> datetime:
    return datetime(2026, 1, number, tzinfo=UTC)


def test_periods_that_meet_are_one():
    second = timedelta(seconds=1)
    end = datetime.max.replace(tzinfo=UTC)
    assert joined_periods([(day(3), day(4)), (day(1), day(2))]) == ((day(1), day(2)), (day(3), day(4)))
    assert joined_periods([(day(1), day(2)), (day(2) + second, day(4))]) == ((day(1), day(4)),)
    assert joined_periods([(day(1), day(9)), (day(2), day(3))]) == ((day(1), day(9)),)
    assert joined_periods([(day(1), end), (day(2), end)]) == ((day(1), end),)
    assert joined_periods([]) == ()
