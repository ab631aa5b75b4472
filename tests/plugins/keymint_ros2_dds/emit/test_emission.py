# SPDX-License-Identifier: Apache-2.0
"""The forms of a permissions document: in full, folded, gathered, by demand; all of them mean what the rules say."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import pytest
from hypothesis import event, given, settings, strategies as st
from keymint_ros2_dds import build_type
from keymint_ros2_dds.compiling import rewriting
from keymint_ros2_dds.emit import emission
from lxml import etree

from keymint.api import BuildOptions, Claim, DomainRange, Hint, Proof
from keymint.api.graph import Edge, Object
from keymint.errors import KeymintError
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.compiling.test_grant_compiler import (
    ASKED,
    DENIED,
    FEW,
    PARTITIONS,
    ROS,
    TOPICS,
    differences,
    rules,
)
from tests.plugins.keymint_ros2_dds.packages import domain_rule, governed, package, rule

USUAL, PLAIN = BuildOptions(), BuildOptions(optimise=False)
TOPIC = ("ros_topic", "ros_publish")


def document(loaded, options=USUAL) -> bytes:
    return build_type.build(loaded, options).documents["permissions.xml"]


def topics(content: bytes, path: str = "*/*/topics/topic") -> list[str]:
    return [item.text or "" for item in etree.fromstring(content).iterfind(f"permissions/grant/{path}")]


def tags(content: bytes) -> list[str]:
    grant = etree.fromstring(content).find("permissions/grant")
    return [item.tag for item in grant if item.tag.endswith("_rule")]


def hint_lists() -> st.SearchStrategy[tuple[Hint, ...]]:
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
    event("gathered" if rewriting.GUARD in topics(content) else "not gathered")


MIXED = st.lists(st.one_of(rules(), rules(PARTITIONS), rules(DENIED)), min_size=1, max_size=5)
ANY_OPTIONS = st.builds(BuildOptions, st.just(value=False), st.booleans(), hint_lists())


@settings(max_examples=tries(30, 60))
@given(st.lists(rules(), min_size=1, max_size=6), ANY_OPTIONS)
def test_every_form_is_decided_as_the_policy_does(drawn, options):
    held_against_the_policy(drawn, options, TOPICS, ((),))


@settings(max_examples=tries(30, 60))
@given(MIXED, ANY_OPTIONS)
def test_every_form_keeps_partitions(drawn, options):
    held_against_the_policy(drawn, options, FEW, ASKED)


@settings(max_examples=tries(30, 60))
@given(MIXED, st.sampled_from([((0, 0),), ((0, 0), (3, 9)), ((5, 6), (200, 200))]))
def test_the_size_of_the_plain_form_is_what_it_would_have(drawn, ranges):
    loaded = package(*drawn, domains=tuple(DomainRange(*each) for each in ranges))
    loaded = governed(loaded, domain_rules=(domain_rule(domains=(DomainRange(0, 230),)),))
    options = (BuildOptions(), PLAIN)
    try:
        small, plain = (build_type.build(loaded, replace(each, allow_vendor_specific=True)) for each in options)
    except KeymintError:
        return
    assert small.plain_sizes == plain.plain_sizes == {"permissions.xml": len(plain.documents["permissions.xml"])}


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
        other = document(package(rule("ALLOW", *TOPIC, "/c")))
        with (
            mock.patch.object(emission.permissions_document, "render", return_value=other),
            pytest.raises(KeymintError) as caught,
        ):
            build_type.build(self.LOADED, BuildOptions())
        assert [found.code for found in caught.value.diagnostics] == ["compile-refuted"]
