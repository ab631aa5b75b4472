# SPDX-License-Identifier: Apache-2.0
"""ROS 2 Ardent: namespaces are partitions, and the law of the compiler holds for pairs of partition and topic."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds import build_type
from keymint_ros2_dds.lowering import name_mapping
from keymint_ros2_dds.lowering.endpoints import endpoints, meanings
from keymint_ros2_dds.lowering.name_mapping import DDS_TOPICS
from lxml import etree

from comarmor.errors import Severity
from comarmor.patterns import expression
from comarmor.patterns.expression import exact
from comarmor.patterns.glob import parse
from comarmor.rules import Effect
from keymint.api import BuildOptions
from keymint.api.graph import Edge, Object
from keymint.errors import KeymintError
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.compiling.test_grant_compiler import built_or_refused
from tests.plugins.keymint_ros2_dds.oracles import cyclone, fastdds, omg
from tests.plugins.keymint_ros2_dds.packages import domain_rule, governed, package, protection, rule

TOPIC = DDS_TOPICS["ros_publish"][0]


def pairs(text: str, **options) -> set[tuple[str, str]]:
    return {(exact(where), exact(what)) for where, what in name_mapping.ardent_patterns(parse(text), TOPIC, **options)}


@pytest.mark.parametrize(
    ("text", "images"),
    [
        ("/chatter", {("rt", "chatter")}),
        ("/a/b/c", {("rt/a/b", "c")}),
        ("*/scan", {("rt", "scan"), ("rt/*", "scan")}),
        ("*", {("rt", "*"), ("rt/*", "*")}),
        ("/a*", {("rt", "a*"), ("rt/a*", "*")}),
        ("?x", {("rt", "x")}),
        ("/a?b", {("rt", "a?b"), ("rt/a", "b")}),
        ("/robot[12]/scan", {("rt/robot1", "scan"), ("rt/robot2", "scan")}),
        ("chatter", set()),
        ("", set()),
    ],
)
def test_the_image_of_a_topic(text, images):
    assert pairs(text) == images


def test_what_is_denied_is_denied_however_the_name_is_divided():
    assert pairs("/a/b/c", every=True) == {("rt/a/b", "c"), ("rt/a", "b/c"), ("rt", "a/b/c")}


def test_a_part_of_a_composite_follows_the_name():
    assert pairs("/t", part="/get_parameters") == {("rt/t", "get_parameters")}


@pytest.mark.parametrize(
    ("permission", "kind", "name", "needed"),
    [
        ("ros_publish", "ros_topic", "/a/b", [("publish", "rt/a", "b")]),
        ("ros_subscribe", "ros_topic", "/b", [("subscribe", "rt", "b")]),
        ("ros_call", "ros_service", "/n/s", [("publish", "rq/n", "sRequest"), ("subscribe", "rr/n", "sReply")]),
        ("ros_execute", "ros_service", "/s", [("subscribe", "rq", "sRequest"), ("publish", "rr", "sReply")]),
    ],
)
def test_the_endpoints_of_an_edge_and_back(permission, kind, name, needed):
    edge = Edge("/t", permission, Object(kind, name), 3)
    found = endpoints("ardent", edge)
    assert [(each.permission, *each.object.partitions, each.object.name) for each in found] == needed
    assert {each.domain for each in found} == {3}
    assert all(meanings("ardent", each) == (edge,) for each in found)


def test_a_raw_topic_in_the_default_partition_is_no_ros_name():
    assert meanings("ardent", Edge("/t", "publish", Object("topic", "chatter"))) == ()
    assert meanings("ardent", Edge("/t", "publish", Object("topic", "chatter", ("rtx",)))) == ()


def test_ardent_has_no_actions():
    action = rule("ALLOW", "ros_action", "ros_request", "/fib", line=12)
    with pytest.raises(KeymintError) as caught:
        build_type.build(package(action, action, distro="ardent"), BuildOptions())
    assert [(found.code, str(found.where)) for found in caught.value.diagnostics] == [
        ("distro-kind", "policy.xml:12"),
        ("distro-kind", "policy.xml:12"),
    ]
    assert "later distro" in caught.value.diagnostics[0].help
    with pytest.raises(KeymintError, match="no ros_action"):
        endpoints("ardent", Edge("/t", "ros_request", Object("ros_action", "/fib")))


def compiled(*rules):
    return build_type.build(package(*rules, distro="ardent"), BuildOptions()).documents["permissions.xml"]


def written(*rules) -> list[tuple[str, list[str], list[str]]]:
    """Return effect, topics and partitions of each criterion."""
    grant = etree.fromstring(compiled(*rules)).find("permissions/grant")
    return [
        (each.tag, [found.text for found in item.find("topics")], [found.text for found in item.find("partitions")])
        for each in grant
        if each.tag in {"allow_rule", "deny_rule"}
        for item in each
        if item.tag != "domains"
    ]


def publish(*names, effect="ALLOW", line=7):
    return rule(effect, "ros_topic", "ros_publish", *names, line=line)


def test_topics_share_a_rule_only_where_their_partitions_are_the_same():
    assert sorted(written(publish("/a/x", "/b/x", "/a/y", "/a/z"))) == [
        ("allow_rule", ["x"], ["rt/a", "rt/b"]),
        ("allow_rule", ["y", "z"], ["rt/a"]),
    ]
    document = compiled(publish("/a/x", "/b/y"))
    for vendor in (omg, cyclone, fastdds):
        assert vendor(document, "publish", "x", ("rt/a",))
        assert vendor(document, "publish", "y", ("rt/b",))
        assert not vendor(document, "publish", "x", ("rt/b",))
        assert not vendor(document, "publish", "y", ("rt/a",))
        assert not vendor(document, "publish", "x")


def test_a_topic_of_a_wildcard_has_the_partitions_of_the_wildcard_too():
    document = compiled(publish("/a/x", "/*"))
    for vendor in (omg, cyclone, fastdds):
        assert vendor(document, "publish", "x", ("rt/a",))
        assert vendor(document, "publish", "x", ("rt",))
        assert vendor(document, "publish", "x", ("rt/b/c", "rt"))
        assert not vendor(document, "publish", "x", ("rq",))


def test_a_denial_under_a_wildcard():
    document = compiled(publish("/a/*"), publish("/a/secret", effect="DENY"))
    for vendor in (omg, cyclone, fastdds):
        assert vendor(document, "publish", "x", ("rt/a",))
        assert vendor(document, "publish", "secret", ("rt/a/b",))
        assert not vendor(document, "publish", "secret", ("rt/a",))


@pytest.mark.parametrize("name", ["/robot?/scan", "/a*b*/scan", "/[!a]x/scan"])
def test_a_namespace_that_vendors_would_not_read_safely_is_refused(name):
    with pytest.raises(KeymintError) as caught:
        compiled(publish(name, line=12))
    (found,) = caught.value.diagnostics
    assert (found.code, str(found.where)) == ("portability-partition", "policy.xml:12")


def test_what_is_denied_within_a_wildcard_of_namespaces_is_refused():
    with pytest.raises(KeymintError) as caught:
        compiled(publish("/robot1/*"), publish("/robot1/private/*", effect="DENY", line=12))
    (found,) = caught.value.diagnostics
    assert (found.code, found.severity, str(found.where)) == (
        "portability-partition",
        Severity.ERROR,
        "policy.xml:12",
    )
    assert "removes a part of the partitions rt/robot1 rt/robot1/*" in found.message


def test_a_governance_rule_is_about_a_base_name_and_that_is_said():
    loaded = package(publish("/a/x"), distro="ardent")
    topics = (protection("ros_topic", "/a/x", data_protection_kind="SIGN"), protection())
    loaded = governed(loaded, domain_rules=(domain_rule(*topics),))
    built = build_type.build(loaded, BuildOptions())
    governance = etree.fromstring(built.documents["governance.xml"])
    assert [each.text for each in governance.iter("topic_expression")] == ["x", "*"]
    assert "governance-base-name" in [found.code for found in built.diagnostics]


# -- the law -----------------------------------------------------------------------------------------------------

_MEANT = {
    ("ros_publish", "publish"): ("rt", ""),
    ("ros_subscribe", "subscribe"): ("rt", ""),
    ("ros_call", "publish"): ("rq", "Request"),
    ("ros_call", "subscribe"): ("rr", "Reply"),
    ("ros_execute", "subscribe"): ("rq", "Request"),
    ("ros_execute", "publish"): ("rr", "Reply"),
}


def concerns(one, action: str, topic: str, partition: str) -> bool:
    for permission, text in itertools.product(one.permissions, one.expressions):
        if permission == action:
            listed = one.partitions or (("*",) if one.effect is Effect.DENY else ("",))
            if expression.matches(text, topic) and any(expression.matches(each, partition) for each in listed):
                return True
        prefix, suffix = _MEANT.get((permission, action), (None, ""))
        if prefix is None or not topic.endswith(suffix) or f"{partition}/".split("/")[0] != prefix:
            continue
        if expression.matches(text, f"{partition[len(prefix) :]}/{topic[: len(topic) - len(suffix)]}"):
            return True
    return False


def permitted(rules, action: str, topic: str, partitions: tuple[str, ...]) -> bool:
    def each(partition: str) -> bool:
        effects = {one.effect for one in rules if concerns(one, action, topic, partition)}
        return effects == {Effect.ALLOW}

    return all(each(partition) for partition in partitions or ("",))


NAMES = st.lists(st.sampled_from(["a", "b", "/", "/", "*", "?", "[ab]", "[!a]"]), min_size=1, max_size=5).map("".join)
EXACT = st.sampled_from(["/a", "/b", "/a/a", "/a/b", "/b/a", "/a/b/a", "/a/*", "*/a", "/a*", "*", "/b/*", "*/a/b"])
ROS = st.one_of(EXACT, EXACT, NAMES.map("/{}".format), NAMES)
RAW = st.sampled_from(["a", "b", "*", "aRequest", "*Request", "a*"])
KINDS = (
    ("ros_topic", ["ros_publish", "ros_subscribe", "ros_publish ros_subscribe"], ROS, st.just(())),
    ("ros_topic", ["ros_publish", "ros_subscribe", "ros_publish ros_subscribe"], ROS, st.just(())),
    ("ros_service", ["ros_call", "ros_execute"], ROS, st.just(())),
    ("topic", ["publish", "subscribe"], RAW, st.lists(st.sampled_from(["", "rt", "rq", "rt/a", "*"]), max_size=2)),
)
TOPICS = ["a", "b", "ab", "ba", "c", "a/b", "b/a", "a/a/b", "]", "aRequest", "bRequest", "aReply", "a/bRequest", "bb"]
PLACES = [
    "",
    "rt",
    "rt/a",
    "rt/b",
    "rt/a/b",
    "rt/b/a",
    "rt/ab",
    "rt/c",
    "rq",
    "rq/a",
    "rq/b/a",
    "rr",
    "rr/a",
    "rtx",
    "x",
]
ASKED = [(), *((place,) for place in PLACES), ("rt", "rt/a"), ("rt/a", "rt/b"), ("", "rq"), ("rq", "rr"), ("rt", "x")]


@st.composite
def drawn_rules(draw):
    kind, permissions, names, partitions = draw(st.sampled_from(KINDS))
    effect = draw(st.sampled_from(["ALLOW", "ALLOW", "ALLOW", "DENY"]))
    expressions = draw(st.lists(names, min_size=1, max_size=2))
    return rule(effect, kind, draw(st.sampled_from(permissions)), *expressions, partitions=draw(partitions))


@settings(max_examples=tries(60, 120), deadline=None)
@given(st.lists(drawn_rules(), min_size=1, max_size=5))
def test_every_vendor_decides_as_the_policy_does_on_pairs_of_partition_and_topic(drawn):
    document = built_or_refused(package(*drawn, distro="ardent"))
    if document is None:
        return
    for action, topic, asked in itertools.product(("publish", "subscribe"), TOPICS, ASKED):
        wanted = permitted(drawn, action, topic, asked)
        for vendor in (omg, cyclone, fastdds):
            decided = vendor(document, action, topic, asked)
            # Ardent never makes a topic with a "/" in its name. It may be denied, but not allowed beyond its name.
            assert decided == wanted or ("/" in topic and not decided), (vendor.__name__, action, topic, asked, wanted)
