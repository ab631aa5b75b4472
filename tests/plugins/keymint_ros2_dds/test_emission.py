"""The forms of a permissions document: in full, folded, gathered, by demand; all of them mean what the rules say."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from dataclasses import replace
from unittest import mock

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from keymint_ros2_dds import build_type, emission
from keymint_ros2_dds.compiling import compile, gathering  # noqa: A004 - the module's name
from lxml import etree

from comarmor.errors import Severity
from keymint.api import BuildOptions, Claim, DomainRange, Governance, Hint, Proof
from keymint.errors import KeymintError
from keymint.graph import Edge, Object
from tests.plugins.keymint_ros2_dds.packages import domain_rule, package, rule

from .compiling.test_compile import ASKED, DENIED, FEW, PARTITIONS, ROS, TOPICS, differences, rules

USUAL, PLAIN = BuildOptions(), BuildOptions(optimise=False)
TOPIC = ("ros_topic", "ros_publish")


def document(loaded, options=USUAL) -> bytes:
    return build_type.build(loaded, options).documents["permissions.xml"]


def topics(content: bytes, path: str = "*/*/topics/topic") -> list[str]:
    return [item.text or "" for item in etree.fromstring(content).iterfind(f"permissions/grant/{path}")]


def tags(content: bytes) -> list[str]:
    grant = etree.fromstring(content).find("permissions/grant")
    return [item.tag for item in grant if item.tag.endswith("_rule")]


@pytest.fixture
def always_gathered() -> Iterator[None]:
    """Gather wherever it is possible, however little it saves."""
    with mock.patch.object(compile, "gathered", functools.partial(gathering.gathered, min_saved=-(10**6))):
        yield


def demands() -> st.SearchStrategy[tuple[Hint, ...]]:
    edge = st.builds(
        lambda permission, name: Edge("/talker", permission, Object("ros_topic", name)),
        st.sampled_from(["ros_publish", "ros_subscribe"]),
        ROS,
    )
    return st.lists(st.builds(Hint, edge, st.integers(0, 9)), max_size=6).map(tuple)


def held_against_the_policy(drawn, options: BuildOptions, names, asked) -> None:
    loaded = package(*drawn)
    try:
        built = build_type.build(loaded, options)
    except KeymintError as error:
        refused = error.diagnostics
    else:
        refused = ()
    if refused:
        event("refused")
        assert {found.code.split("-")[0] for found in refused} == {"portability"}
        return
    content = built.documents["permissions.xml"]
    assert list(differences(loaded, content, names, asked)) == []
    assert not {"rewriting-unproven", "compile-unproven"} & {found.code for found in built.diagnostics}
    event("gathered" if gathering.GUARD in topics(content) else "not gathered")


MIXED = st.lists(st.one_of(rules(), rules(PARTITIONS), rules(DENIED)), min_size=1, max_size=5)
ANY_OPTIONS = st.builds(BuildOptions, st.just(value=False), st.booleans(), demands())


@settings(max_examples=60)
@given(st.lists(rules(), min_size=1, max_size=6), ANY_OPTIONS)
def test_every_form_is_decided_as_the_policy_does(drawn, options):
    held_against_the_policy(drawn, options, TOPICS, ((),))


@settings(max_examples=60)
@given(MIXED, ANY_OPTIONS)
def test_every_form_keeps_partitions(drawn, options):
    held_against_the_policy(drawn, options, FEW, ASKED)


@settings(max_examples=100)
@given(st.lists(rules(), min_size=1, max_size=6), demands())
def test_gathering_changes_no_decision(drawn, demand):
    with mock.patch.object(compile, "gathered", functools.partial(gathering.gathered, min_saved=-(10**6))):
        held_against_the_policy(drawn, BuildOptions(demand=demand), TOPICS, ((),))


@settings(max_examples=60)
@given(MIXED, st.sampled_from([((0, 0),), ((0, 0), (3, 9)), ((5, 6), (200, 200))]))
def test_the_size_of_the_plain_form_is_what_it_would_have(drawn, ranges):
    loaded = package(*drawn, domains=tuple(DomainRange(*each) for each in ranges))
    loaded = replace(loaded, governance=Governance("permissions_ca", (domain_rule(domains=(DomainRange(0, 230),)),)))
    options = (BuildOptions(), PLAIN)
    try:
        small, plain = (build_type.build(loaded, replace(each, allow_vendor_specific=True)) for each in options)
    except KeymintError:
        return
    assert small.plain_sizes == plain.plain_sizes == {"permissions.xml": len(plain.documents["permissions.xml"])}


@settings(max_examples=60)
@given(MIXED)
def test_gathering_keeps_partitions(drawn):
    with mock.patch.object(compile, "gathered", functools.partial(gathering.gathered, min_saved=-(10**6))):
        held_against_the_policy(drawn, BuildOptions(), FEW, ASKED)


class TestThePlainForm:
    RULES = (
        rule("ALLOW", *TOPIC, "/a", "/b", "/ab*"),
        rule("ALLOW", *TOPIC, "/ab/c", "/b"),
        rule("DENY", *TOPIC, "/ab/secret"),
    )

    def test_has_a_rule_for_each_of_the_policys_and_leaves_nothing_out(self) -> None:
        content = document(package(*self.RULES), PLAIN)
        assert tags(content) == ["allow_rule", "allow_rule", "deny_rule", "allow_rule"]
        assert sorted(topics(content)) == ["rt/a", "rt/ab*", "rt/ab/c", "rt/ab/secret", "rt/b"]

    def test_the_other_form_says_only_what_is_needed(self) -> None:
        content = document(package(*self.RULES))
        assert tags(content) == ["allow_rule", "deny_rule", "allow_rule"]
        assert sorted(topics(content)) == ["rt/a", "rt/ab*", "rt/ab/secret", "rt/b"]

    def test_what_only_it_would_need_is_written_alike_or_left_out(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, "/ax", "/b"), rule("DENY", *TOPIC, "/a[!]]"))
        for options in (USUAL, PLAIN):
            built = build_type.build(loaded, options)
            assert [found.severity for found in built.diagnostics] == []
            assert list(differences(loaded, built.documents["permissions.xml"], ["rt/ax", "rt/b", "rt/a]"])) == []

    def test_who_is_allowed_nothing_joins_no_domain_either(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, "/a"), rule("DENY", *TOPIC, "/*"))
        assert [tags(document(loaded, options)) for options in (USUAL, PLAIN)] == [[], []]

    def test_its_size_is_told_whichever_form_is_written(self) -> None:
        loaded = package(*self.RULES)
        size = len(document(loaded, PLAIN))
        for options in (PLAIN, BuildOptions()):
            assert build_type.build(loaded, options).plain_sizes == {"permissions.xml": size}
        assert len(document(loaded)) < size


class TestGathering:
    AXLES = tuple(f"/axle{number:03}" for number in range(200))

    def test_names_that_differ_in_a_digit_share_an_expression(self) -> None:
        content = document(package(rule("ALLOW", *TOPIC, *self.AXLES)))
        (pattern,) = topics(content, "allow_rule/publish/topics/topic")
        assert re.fullmatch(r"rt/axle\[01\]\[0123456789\]\[0123456789\]", pattern)
        assert topics(content, "deny_rule/publish/topics/topic") == ["*]*"]

    def test_an_allow_rule_stands_first_and_last(self) -> None:
        assert tags(document(package(rule("ALLOW", *TOPIC, *self.AXLES)))) == ["allow_rule", "deny_rule", "allow_rule"]

    def test_what_saves_little_is_left_as_it_is(self) -> None:
        content = document(package(rule("ALLOW", *TOPIC, *self.AXLES[:9])))
        assert topics(content) == [f"rt{name}" for name in self.AXLES[:9]]

    def test_a_name_that_the_other_direction_denies_stays_in_its_place(self) -> None:
        denied = rule("DENY", "ros_topic", "ros_subscribe", "/axle007")
        hears = rule("ALLOW", "ros_topic", "ros_subscribe", "/axle*")
        content = document(package(rule("ALLOW", *TOPIC, *self.AXLES), denied, hears))
        assert "rt/axle007" in topics(content, "allow_rule/publish/topics/topic")

    def test_a_note_says_who_may_not_know_bracket_expressions(self) -> None:
        found = build_type.build(package(rule("ALLOW", *TOPIC, *self.AXLES)), BuildOptions()).diagnostics
        assert [(each.code, each.severity) for each in found] == [("vendor-wildcard", Severity.NOTE)]
        assert "--no-optimise" in found[0].help

    def test_hints_do_not_overtake_the_guard(self) -> None:
        relays = rule("ALLOW", "ros_topic", "ros_relay", "/axle001")
        loaded = package(rule("ALLOW", *TOPIC, *self.AXLES), relays)
        edge = Edge("/talker", "ros_publish", Object("ros_topic", "/axle001"))
        built = build_type.build(loaded, BuildOptions(demand=(Hint(edge, 9),)))
        assert "rewriting-unproven" not in [found.code for found in built.diagnostics]
        assert gathering.GUARD in topics(built.documents["permissions.xml"])

    def test_a_document_that_broke_handshakes_fits(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, *(f"/cell{n % 4}/sensor_{n:04}" for n in range(2000))))
        codes = [each.code for each in build_type.build(loaded, PLAIN).diagnostics]
        assert codes == ["size-permissions"]
        assert "size-permissions" not in [each.code for each in build_type.build(loaded, BuildOptions()).diagnostics]


class TestPriority:
    def demand(self, *asked: tuple[str, int], permission: str = "ros_publish") -> BuildOptions:
        edges = ((Edge("/talker", permission, Object("ros_topic", name)), times) for name, times in asked)
        return BuildOptions(demand=tuple(Hint(edge, times) for edge, times in edges))

    def test_expressions_stand_by_how_often_they_are_asked_for(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, "/a", "/b", "/c*"))
        assert topics(document(loaded)) == ["rt/a", "rt/b", "rt/c*"]
        hinted = self.demand(("/b", 1), ("/cat", 2), ("/cow", 3))
        assert topics(document(loaded, hinted)) == ["rt/c*", "rt/b", "rt/a"]

    def test_rules_about_other_partitions_change_places(self) -> None:
        raw = [rule("ALLOW", "topic", "publish", name, partitions=[name]) for name in ("p", "q")]
        loaded = package(*raw)
        hinted = BuildOptions(demand=(Hint(Edge("/talker", "publish", Object("topic", "q", ("q",))), 5),))
        assert topics(document(loaded)) == ["p", "q"]
        assert topics(document(loaded, hinted)) == ["q", "p"]

    def test_a_denial_is_overtaken_by_nothing_that_it_touches(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, "/a*"), rule("DENY", *TOPIC, "/ab"), rule("ALLOW", *TOPIC, "/z"))
        hinted = self.demand(("/aa", 100))
        assert topics(document(loaded, hinted)) == ["rt/z", "rt/ab", "rt/a*"]

    def test_what_nobody_can_ask_for_is_passed_over(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, "/a"), distro="ardent")
        edge = Edge("/talker", "ros_request", Object("ros_action", "/fibonacci"))
        assert topics(document(loaded, BuildOptions(demand=(Hint(edge, 1),)))) == ["a"]


class TestWhatIsNotProven:
    """No input is known that gets this far, so that the proof itself is made to say so."""

    LOADED = package(rule("ALLOW", *TOPIC, "/a", "/a*"), rule("ALLOW", *TOPIC, "/b"))

    @staticmethod
    def claims(*proofs: Proof):
        made = ((Claim("omg", "publish", (DomainRange(0, 0),), "", proof, "too hard"),) for proof in proofs)
        return mock.patch.object(emission, "prove_content", side_effect=list(made))

    def test_the_plain_form_is_written_instead(self) -> None:
        plain = document(self.LOADED, PLAIN)
        with self.claims(Proof.UNKNOWN, Proof.PROVEN):
            built = build_type.build(self.LOADED, BuildOptions())
        assert built.documents["permissions.xml"] == plain
        assert [found.code for found in built.diagnostics] == ["rewriting-unproven"]

    def test_that_the_plain_form_is_not_is_said(self) -> None:
        with self.claims(Proof.UNKNOWN):
            built = build_type.build(self.LOADED, PLAIN)
        assert [found.code for found in built.diagnostics] == ["compile-unproven"]

    def test_a_document_that_is_refuted_is_an_error(self) -> None:
        with (
            mock.patch.object(emission.dds_xml, "render", return_value=document(package(rule("ALLOW", *TOPIC, "/c")))),
            pytest.raises(KeymintError) as caught,
        ):
            build_type.build(self.LOADED, BuildOptions())
        assert [found.code for found in caught.value.diagnostics] == ["compile-refuted"]
