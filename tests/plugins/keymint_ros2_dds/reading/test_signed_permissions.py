# SPDX-License-Identifier: Apache-2.0
"""A permissions document as data types that know their lines."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.lowering.lowered_rules import DEFAULT, EVERY, GrantRule
from keymint_ros2_dds.lowering.name_mapping import TOPIC_ACTIONS
from keymint_ros2_dds.reading import signed_permissions
from keymint_ros2_dds.reading.signed_permissions import read

from comarmor.rules import Effect
from keymint.api import DomainRange
from keymint.errors import KeymintError
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.decision.documents import PLAIN, criteria, document, grant, rule
from tests.plugins.keymint_ros2_dds.packages import package


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"<domains><id>0</id></domains>", b""),
        (b"<id>0</id>", b"<id_range/>"),
        (b"<id>0</id>", b"<id_range><max>3</max></id_range>"),
        (b"<topic>rt/x</topic>", b"<topic> </topic>"),
        (b"<topic>rt/x</topic>", b"<topic/>"),
        (b"<default>DENY</default>", b"<default/>"),
    ],
)
def test_what_crashes_cyclone_dds_is_found_in_any_document(old: bytes, new: bytes) -> None:
    assert read(PLAIN).crash is None
    assert read(PLAIN.replace(old, new, 1)).crash is not None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"<topic>rt/x</topic>", b"<topic/>", "<topic> is empty"),
        (b"<default>DENY</default>", b"",
         "<grant> is not complete, expected <default>"),
    ],
)  # fmt: skip
def test_what_the_schema_says_is_said_in_words(old: bytes, new: bytes, message: str) -> None:
    assert [each.message for each in read(PLAIN.replace(old, new, 1)).defects] == [message]


@pytest.mark.parametrize("content", [b"", b"<dds/>", b"<dds><permissions>", b"<!DOCTYPE dds><dds><permissions/></dds>"])
def test_what_is_no_permissions_document_is_refused(content: bytes) -> None:
    with pytest.raises(KeymintError):
        read(content)


def test_a_domain_that_is_no_number_is_refused_with_its_line() -> None:
    with pytest.raises(KeymintError, match=r"permissions.xml:3: 'x' is no domain id"):
        read(document(grant(rule("allow", criteria("publish", "rt/x"), domains="<id>x</id>"))))


def test_a_domain_with_more_digits_than_python_reads_is_refused_with_its_line() -> None:
    with pytest.raises(KeymintError, match=r"permissions.xml:3: '9{60}…' is no domain id"):
        read(document(grant(rule("allow", criteria("publish", "rt/x"), domains=f"<id>{'9' * 5000}</id>"))))


def test_every_part_knows_its_line_and_place() -> None:
    found = read(b"\n\n" + PLAIN, "p.p7s", 10)
    lines = PLAIN.splitlines()
    (only_grant,) = found.grants
    assert lines[only_grant.line - 3].startswith(b"<grant")
    assert [lines[each.line - 3].split(b">")[0] for each in only_grant.rules] == [
        b"<allow_rule",
        b"<deny_rule",
        b"<allow_rule",
    ]
    assert [lines[each.line - 3].split(b">")[0] for each in only_grant.rules[0].criteria] == [
        b"<publish",
        b"<subscribe",
    ]
    assert str(found.place(only_grant.line)) == f"p.p7s:{only_grant.line + 10}"


def test_the_content_is_read_as_it_is_written() -> None:
    texts = criteria("publish", " rt/x ", "a&b", partitions=("", "p*"), tags="t")
    (only_grant,) = read(document(grant(rule("deny", texts), subject=" CN=/a "))).grants
    assert (only_grant.subject_name, only_grant.not_before, only_grant.not_after) == (
        " CN=/a ",
        "2026-01-01T00:00:00",
        "2027-01-01T00:00:00",
    )
    (only,) = only_grant.rules
    (part,) = only.criteria
    assert (only.allows, only_grant.allows) == (False, False)
    assert (part.topics, part.partitions, part.tags) == ((" rt/x ", "a&b"), ("", "p*"), (("t", "v"),))


def test_without_partitions_or_tags_there_are_none() -> None:
    (only_grant,) = read(document(grant(rule("allow", criteria("relay", "x")), default="ALLOW"))).grants
    (part,) = only_grant.rules[0].criteria
    assert (part.action, part.partitions, part.tags) == ("relay", None, None)
    assert only_grant.allows


@given(st.integers(0, 230), st.integers(0, 230), st.integers(0, 230))
def test_domains_contain_their_range(first: int, last: int, domain: int) -> None:
    ends = f"<id>{first}</id><id_range><min>{first}</min><max>{last}</max></id_range>"
    open_ = f"<id_range><min>{first}</min></id_range><id_range><max>{last}</max></id_range>"
    (only_grant,) = read(document(grant(rule("allow", criteria("publish", "x"), domains=ends + open_)))).grants
    for exact in (True, False):
        answers = [each.contain(domain, min_only_is_exact=exact) for each in only_grant.rules[0].domains]
        from_first = domain == first if exact else domain >= first
        assert answers == [domain == first, first <= domain <= last, from_first, domain <= last]


def test_errors_have_the_line_in_the_file() -> None:
    for content, line in ((b"<dds><permissions>\n</dds>", 12), (b"\n\n<other/>", 13)):
        with pytest.raises(KeymintError) as caught:
            read(content, "p.p7s", 10)
        assert str(caught.value.diagnostics[0].where) == f"p.p7s:{line}"
    broken = PLAIN.replace(b"<default>DENY</default>", b"")
    assert read(broken, "p.p7s", 10).defect.startswith("the schema refuses it: p.p7s:12:")
    assert read(PLAIN).defect == ""


TEXTS = st.lists(st.sampled_from(["rt/a", "rt/*", "a=b", "[!a-b]", "]", "x y", "a&b", "é"]), min_size=1, max_size=3)
RULES = st.builds(
    lambda effect, partitions, topics: GrantRule(effect, partitions, {each: tuple(topics[each]) for each in topics}),
    st.sampled_from(Effect),
    st.sampled_from([DEFAULT, EVERY, ("", "p")]),
    st.fixed_dictionaries({}, optional=dict.fromkeys(TOPIC_ACTIONS, TEXTS)),
)
DOMAINS = st.sampled_from([(DomainRange(0, 0),), (DomainRange(0, 0), DomainRange(2, 7)), (DomainRange(3, 230),)])
CHANGES = ["", "x", " ", "\t", "\r", "<", ">", "&amp;", "]]>", "xmlns=", "9", "é", "/", "-", '"', "!", "<!---->", "="]


@st.composite
def written_documents(draw):
    """Draw documents that Keymint writes, and such documents with a line or a few characters changed."""
    rights = replace(
        package().grant, name=draw(st.sampled_from(["/talker", "a b", '"', "xmlns="])), domains=draw(DOMAINS)
    )
    lines = permissions_document.render(rights, draw(st.lists(RULES, max_size=3))).decode().split("\n")
    for _ in range(draw(st.integers(0, 2))):
        at = draw(st.integers(0, len(lines) - 1))
        line = lines.pop(at) if draw(st.booleans()) else lines[at]
        if draw(st.booleans()):
            lines.insert(draw(st.integers(0, len(lines))), line)
        else:
            cut = draw(st.integers(0, len(line)))
            changed = line[:cut] + draw(st.sampled_from(CHANGES)) + line[cut + draw(st.integers(0, 3)) :]
            lines.insert(at, changed)
    return "\n".join(lines).encode()


@settings(max_examples=tries(80, 400), deadline=None)
@given(written_documents())
def test_a_document_in_the_written_form_is_read_as_any_other(content: bytes) -> None:
    fast = signed_permissions._plain(content)
    if fast is not None:
        with mock.patch.object(signed_permissions, "_plain", return_value=None):
            document = read(content)
        assert (document.grants, document.defects, document.quirks, document.crash) == (fast, (), (), None)
        hazards = dds_xml.hazards(content)
        assert signed_permissions.is_plain(content) == (not hazards)


def test_a_blank_after_the_subject_is_not_plain() -> None:
    content = permissions_document.render(package().grant, ())
    assert signed_permissions.is_plain(content)
    assert not signed_permissions.is_plain(content.replace(b"</subject_name>", b" </subject_name>"))


def test_a_minimum_above_the_highest_domain_is_not_plain() -> None:
    rules = (GrantRule(Effect.ALLOW, DEFAULT, {"publish": ("rt/a",)}),)
    content = permissions_document.render(replace(package().grant, domains=(DomainRange(3, 230),)), rules)
    assert signed_permissions.is_plain(content)
    assert not signed_permissions.is_plain(content.replace(b"<min>3<", b"<min>231<"))


def test_what_keymint_writes_is_read_fast() -> None:
    rules = (GrantRule(Effect.ALLOW, EVERY, {"publish": ("rt/a", "rt/*"), "relay": ("b",)}),)
    assert signed_permissions._plain(permissions_document.render(package().grant, rules)) is not None


def test_criteria_in_another_order_than_that_of_the_schema_are_not_read_fast() -> None:
    rules = (GrantRule(Effect.ALLOW, EVERY, {"publish": ("rt/a",), "subscribe": ("rt/a",)}),)
    content = permissions_document.render(package().grant, rules)
    swapped = content.replace(b"publish>", b"other>").replace(b"subscribe>", b"publish>")
    swapped = swapped.replace(b"other>", b"subscribe>")
    assert signed_permissions._plain(content) is not None
    assert signed_permissions._plain(swapped) is None
    assert read(swapped).defects
