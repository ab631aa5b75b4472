# SPDX-License-Identifier: Apache-2.0
"""The permissions document: one grant for one subject."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

from hypothesis import given, strategies as st
from keymint_ros2_dds import build_type
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.lowering.lowered_rules import DEFAULT, GrantRule
from keymint_ros2_dds.lowering.name_mapping import TOPIC_ACTIONS
from lxml import etree

from comarmor.rules import Effect
from keymint.api import DomainRange
from tests.plugins.keymint_ros2_dds.builds import CHATTER, STRICT, permissions, shape
from tests.plugins.keymint_ros2_dds.packages import domain_rule, governed, package, rule


def test_the_grant():
    grant = permissions(CHATTER).find("permissions/grant")
    assert grant.get("name") == "/talker"
    assert grant.findtext("subject_name") == "CN=/talker,OU=x1"
    assert grant.findtext("validity/not_before") == "2026-11-20T00:00:00"
    assert grant.findtext("validity/not_after") == "2027-11-20T00:00:00"
    assert [child.tag for child in grant] == ["subject_name", "validity", "allow_rule", "default"]
    assert grant.findtext("default") == "DENY"
    assert grant.findtext("allow_rule/publish/topics/topic") == "rt/chatter"


def test_domains_are_written_with_both_ends():
    ranges = (DomainRange(5, 7), DomainRange(0, 0), DomainRange(8, 9))
    loaded = package(CHATTER, domains=ranges)
    wide = governed(loaded, domain_rules=(domain_rule(domains=(DomainRange(0, 10),)),))
    built = build_type.build(wide, STRICT)
    domains = etree.fromstring(built.documents["permissions.xml"]).find(".//domains")
    assert [(item.tag, [each.text for each in item] or item.text) for item in domains] == [
        ("id", "0"),
        ("id_range", ["5", "9"]),
    ]


def test_names_are_escaped_as_xml():
    assert shape(rule("ALLOW", "topic", "publish", "a<b&c>'\"")) == [("allow_rule", {"publish": ["a<b&c>'\""]})]


TEXTS = st.text(
    st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], exclude_characters="\ufffe\uffff"), min_size=1
)
ACTIONS = st.sampled_from(TOPIC_ACTIONS)


@given(
    st.lists(
        st.builds(
            GrantRule,
            effect=st.sampled_from(Effect),
            partitions=st.lists(TEXTS | st.just(""), min_size=1, max_size=2).map(tuple),
            topics=st.dictionaries(ACTIONS, st.lists(TEXTS, min_size=1, max_size=3).map(tuple)),
        ),
        max_size=3,
    ),
    TEXTS | st.just("a\tb\nc\r\"'<&>"),
    st.sampled_from([dds_xml.INDENTED, 0]),
)
def test_the_text_is_what_lxml_writes_for_the_same_tree(rules, name, limit):
    """Escapes, indentation and order are those of a library."""
    grant = package(name="CN=a&b", domains=(DomainRange(0, 1), DomainRange(3, 3))).grant
    with mock.patch.object(dds_xml, "INDENTED", limit):
        content = permissions_document.render(replace(grant, name=name), rules)
    root = etree.fromstring(content)
    for element in root.iter():
        element.text = None if len(element) else element.text or ""
        element.tail = None
    etree.indent(root, "  " if limit else "")
    head = b'<?xml version="1.0" encoding="UTF-8"?>\n'
    assert content == head + etree.tostring(root, encoding="utf-8") + b"\n"
    assert root.find("permissions/grant").get("name") == name
    assert [[each.text for each in listed] for listed in root.iter("topics")] == [
        list(texts) for rule in rules for texts in rule.topics.values()
    ]
    assert [[each.text or "" for each in listed] for listed in root.iter("partitions")] == [
        list(rule.partitions) for rule in rules if rule.partitions != DEFAULT for _ in rule.topics
    ]
