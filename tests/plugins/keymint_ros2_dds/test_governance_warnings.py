# SPDX-License-Identifier: Apache-2.0
"""What the governance of a package leaves open."""

from __future__ import annotations

from keymint_ros2_dds import build_type

from comarmor.errors import Origin
from tests.plugins.keymint_ros2_dds.documents.test_governance_document import STRICT, build
from tests.plugins.keymint_ros2_dds.packages import domain_rule, governed, package, protection, rule


def test_what_the_sources_open_is_a_warning_at_the_rule_and_a_note_where_the_profile_accepts_it():
    where = Origin("governance.xml", 31)
    topic = protection("ros_topic", "/diagnostics", enable_write_access_control=False, origin=where)
    loaded = package(rule("ALLOW", "ros_topic", "ros_publish", "/chatter"))
    for accepts, severity in ((False, "warning"), (True, "note")):
        rules = (domain_rule(topic, protection(), enable_join_access_control=False),)
        opened = governed(loaded, domain_rules=rules, accepts_open=accepts)
        said = build_type.build(opened, STRICT).diagnostics
        assert [(each.code, each.severity) for each in said] == [
            ("governance-open-join", severity), ("governance-open", severity),
        ]  # fmt: skip
        assert str(said[1].where) == "governance.xml:31"
        assert "enable_write_access_control is false for '/diagnostics'" in said[1].message
        assert ("<exceptions><open_governance/></exceptions>" in said[1].help) is not accepts


def test_what_the_policy_allows_everybody_in_every_partition_is_not_opened():
    everything = rule("ALLOW", "topic", "publish", "raw*", partitions=("*",))
    topics = (protection("topic", "raw?", enable_write_access_control=False), protection())
    rules = (domain_rule(*topics),)
    assert build_type.build(governed(package(everything), domain_rules=rules), STRICT).diagnostics == ()
    denied = package(everything, rule("DENY", "topic", "publish", "rawx"))
    said = build_type.build(governed(denied, domain_rules=rules), STRICT).diagnostics
    assert [each.code for each in said if each.code.startswith("governance")] == ["governance-open"]


def test_a_rule_that_never_counts_opens_nothing():
    open_ = protection(enable_read_access_control=False)
    assert [found.code for found in build(protection(), open_).diagnostics] == ["governance-shadowed"]
    loaded = package(rule("ALLOW", "ros_topic", "ros_publish", "/chatter"))
    shadowed = governed(loaded, domain_rules=(domain_rule(), domain_rule(open_)))
    assert build_type.build(shadowed, STRICT).diagnostics == ()


def test_topics_that_nothing_protects_are_said():
    topic = protection(metadata_protection_kind="NONE", data_protection_kind="NONE")
    assert [found.code for found in build(topic, rtps_protection_kind="NONE").diagnostics] == ["governance-unprotected"]
    assert build(topic).diagnostics == ()
