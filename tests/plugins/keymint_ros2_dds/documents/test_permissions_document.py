# SPDX-License-Identifier: Apache-2.0
"""The permissions document: one grant for one subject."""

from __future__ import annotations

from keymint_ros2_dds import build_type
from lxml import etree

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
