# SPDX-License-Identifier: Apache-2.0
"""Expressions of policies, and those written for patterns; the oracle is ``fnmatch()`` of the C library."""

from __future__ import annotations

import ctypes

import pytest
from hypothesis import assume, example, given, settings, strategies as st

from comarmor.errors import ComArmorError, Origin
from comarmor.patterns import expression
from comarmor.patterns.expression import canonical, escape, exact, rule_matches, rule_matches_partition
from comarmor.patterns.glob import matches, parse
from comarmor.patterns.tokens import PatternError
from comarmor.rules import PARTS, Effect, Rule, parts
from tests.effort import tries

LIBC = ctypes.CDLL(None)

ATOMS = ("*", "?", "a", "b", "z", "/", "-", "!", "^", ".", ":", "{", "}", "]", "[ab]", "[!a]", "[^b-z]", "[]a]", "[a-]")
MORE = (
    "[!]-a]",
    "[[:alpha:]]",
    "[![:digit:]_]",
    "[[:punct:]]",
    "\\*",
    "\\[",
    "\\\\",
    "[\\]x]",
    "[a\\-z]",
    "[--0]",
    "[",
)
PATTERNS = st.lists(st.sampled_from(ATOMS + MORE), max_size=7).map("".join)
NAMES = st.text(alphabet="abz/-!^.:{}][*\\_0", max_size=8)


def fnmatch(pattern: str, name: str) -> bool:
    """Match by the C library, in the C locale, in which a byte is a character."""
    return LIBC.fnmatch(pattern.encode("latin-1"), name.encode("latin-1"), 0) == 0


@settings(max_examples=tries(250, 1500), deadline=None)
@given(PATTERNS, NAMES)
@example("[a", "[a")
@example("[!]", "[!]")
@example("[[:alpha:]", "[a")
@example("[a-c-e]", "-")
@example("*[", "x[")
@example("*", "")
def test_matches_what_the_c_library_matches(pattern: str, name: str) -> None:
    assume(not pattern.endswith(("[a-", "-")))  # glibc reads a range in a bracket that is never closed
    try:
        found = expression.matches(pattern, name)
    except ComArmorError:
        assume(False)
    assert found == fnmatch(pattern, name)


@given(PATTERNS, NAMES)
def test_canonical_notation_means_the_same(pattern: str, name: str) -> None:
    try:
        notation = canonical(expression.parse(pattern))
    except ComArmorError:
        return
    assert expression.matches(notation, name) == expression.matches(pattern, name)
    assert canonical(expression.parse(notation)) == notation


@given(st.text(max_size=12), st.text(max_size=12))
def test_escaped_text_matches_only_itself(text: str, other: str) -> None:
    escaped = escape(text)
    assert expression.literal(escaped) == text
    assert expression.matches(escaped, text)
    assert expression.matches(escaped, other) == (text == other)


def test_wildcards_match_slashes() -> None:
    assert expression.matches("*/talker", "/a/b/talker")
    assert expression.matches("/a?b", "/a/b")
    assert not expression.matches("/a", "/a\n")
    assert expression.matches("/a*", "/a\nb")


def test_text_beyond_ascii_is_compared_by_code_points() -> None:
    assert expression.matches("/?", "/é")
    assert expression.matches("[à-ï]", "é")
    assert not expression.matches("[[:alpha:]]", "é")
    assert expression.matches("?", "\U0001f600")


def test_literals() -> None:
    assert expression.literal("/talker") == "/talker"
    assert expression.literal("/a\\*b") == "/a*b"
    assert expression.literal("/a*") is None
    assert expression.literal("[a]") is None
    assert expression.literal("?") is None


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("a\\", "lone"),
        ("[[:alhpa:]]", "did you mean 'alpha'?"),
        ("[[:ALPHA:]]", "did you mean 'alpha'?"),
        ("[[.a.]]", "collating element"),
        ("[[=a=]]", "equivalence class"),
        ("[z-a]", "range z-a is empty"),
        ("[a-[:digit:]]", "cannot end a range"),
        ("[a-[:digit:]", "cannot end a range"),
    ],
)
def test_what_has_no_meaning_is_refused(pattern: str, message: str) -> None:
    with pytest.raises(ComArmorError, match=message.replace("?", "\\?")):
        expression.matches(pattern, "x")


@pytest.mark.parametrize("pattern", ["*a" * 40 + "b", "*?a" * 40 + "b", "*[ab]*" * 40 + "c", "*" * 4000 + "b"])
def test_no_expression_takes_exponential_time(pattern: str) -> None:
    assert not expression.matches(pattern, "a" * 2000)  # or this would never end


PIECES = st.sampled_from([*"ab/]-^!\\[_.", "*", "?", "[ab]", "[!a]", "[a-b]", "[]a]", "[!]]", "[[:alpha:]]", "[\\]a]"])
EXPRESSIONS = st.lists(PIECES, max_size=5).map("".join)
TEXTS = st.text(alphabet="ab/]-^!\\[c_.", max_size=5)


@given(expression=EXPRESSIONS, text=TEXTS, unescaped=st.sampled_from(["", "_/."]))
def test_the_c_library_reads_what_is_written(expression, text, unescaped):
    try:
        pattern = parse(expression)
    except PatternError:
        assume(False)
    written = exact(pattern, unescaped=unescaped)
    assert parse(written) == pattern
    assert (LIBC.fnmatch(written.encode(), text.encode(), 0) == 0) == matches(pattern, text)


@pytest.mark.parametrize("expression", ["x[b-a]", "[b-a]", "x[b-a]*"])
def test_a_set_without_members_is_written_as_one(expression):
    """This raised IndexError in documents, and was shown as ``[]``, which is ordinary text."""
    assert exact(parse(expression)) == expression


@pytest.mark.parametrize(
    ("expression", "written"),
    [("[_a]", "[\\_a]"), ("[!/]*", "[!\\/]*"), ("a\\*", "a\\*"), ("[[:digit:]]?", "[0-9]?"), ("*?", "?*")],
)
def test_members_of_sets_are_escaped(expression, written):
    assert exact(parse(expression)) == written


def test_harmless_members_may_stay_unescaped():
    assert exact(parse("[_/!]"), unescaped="_/.") == "[\\!/_]"


def rule(kind, permissions, *expressions, effect=Effect.ALLOW, partitions=()):
    return Rule(effect, kind, permissions, expressions, partitions, False, Origin("policy.xml", 1))


def test_a_rule_applies_to_objects_of_its_kind_that_any_expression_matches():
    topics = rule("ros_topic", ("ros_publish",), "/a", "/b*")
    assert rule_matches(topics, "ros_topic", "ros_publish", "/a")
    assert rule_matches(topics, "ros_topic", "ros_publish", "/bc")
    assert not rule_matches(topics, "ros_topic", "ros_publish", "/c")
    assert not rule_matches(topics, "ros_topic", "ros_subscribe", "/a")
    assert not rule_matches(topics, "topic", "publish", "/a")


@given(st.sampled_from(sorted(PARTS)), st.sampled_from(["/a", "/b", "/a/b"]), st.sampled_from(["/a", "/a*", "*", "/?"]))
def test_a_composite_rule_applies_to_exactly_the_parts_of_the_objects_it_applies_to(composite, name, expression):
    kind, permission = composite
    granted = rule(kind, (permission,), expression)
    implemented = {(k, p, name + suffix) for k, p, suffix in parts(kind, permission)}
    every_part = {(k, p, name + suffix) for each in PARTS.values() for k, p, suffix in each}
    for part in every_part:
        applies = part in implemented and rule_matches(granted, kind, permission, name)
        assert rule_matches(granted, *part) is applies


def test_an_expression_matches_the_name_before_the_suffix_of_a_part():
    reads = rule("ros_parameter", ("ros_read",), "/n")
    assert rule_matches(reads, "ros_service", "ros_call", "/n/get_parameters")
    assert not rule_matches(reads, "ros_service", "ros_call", "/n/get_parameters/get_parameters")
    assert not rule_matches(reads, "ros_service", "ros_execute", "/n/get_parameters")
    assert not rule_matches(reads, "ros_service", "ros_call", "/n/set_parameters")


@pytest.mark.parametrize("effect", Effect)
@pytest.mark.parametrize(
    ("partitions", "matched", "unmatched"),
    [(("p*", ""), {"", "p", "px"}, {"q"}), (("",), {""}, {"p"}), (("*",), {"", "p"}, set())],
)
def test_partitions_of_a_rule(effect, partitions, matched, unmatched):
    raw = rule("topic", ("publish",), "t", effect=effect, partitions=partitions)
    assert {each for each in matched | unmatched if rule_matches_partition(raw, each)} == matched


def test_a_rule_without_partitions_allows_the_default_one_and_denies_all():
    assert rule_matches_partition(rule("topic", ("publish",), "t"), "")
    assert not rule_matches_partition(rule("topic", ("publish",), "t"), "p")
    assert rule_matches_partition(rule("topic", ("publish",), "t", effect=Effect.DENY), "p")
