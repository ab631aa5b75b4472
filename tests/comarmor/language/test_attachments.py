# SPDX-License-Identifier: Apache-2.0
"""Attachments: placeholders for the subject's name, and errors of their notation."""

from __future__ import annotations

import re
from itertools import product

import pytest
from hypothesis import given, strategies as st

from comarmor.errors import ComArmorError
from comarmor.language import attachments
from comarmor.language.attachments import (
    MOST_CHARACTERS,
    MOST_VALUES,
    NAME,
    NAMESPACE,
    TunableReference,
    expand,
    for_parts,
    parse,
    parts,
)
from comarmor.patterns import expression
from comarmor.patterns.expression import escape

from .policies import allow, profile, topics


@pytest.mark.parametrize(
    ("attachment", "subject", "expression"),
    [
        ("{name}", "/foo/bar/talker", "talker"),
        ("{namespace}", "/foo/bar/talker", "/foo/bar/"),
        ("{namespace}x", "/talker", "/x"),
        ("{namespace}/x", "/talker", "/x"),
        ("{namespace}/x", "/foo/talker", "/foo/x"),
        ("{namespace}//x", "/foo/talker", "/foo//x"),
        ("/{namespace}x", "/foo/talker", "/foo/x"),
        ("{namespace}{name}/{name}", "/foo/t", "/foo/t/t"),
        ("//x/{name}", "/t", "//x/t"),
        ("{namespace}/{namespace}", "/a/b", "/a/a/"),
        ("\\{name\\}", "/t", "\\{name\\}"),
        ("{namespace}\\/x", "/foo/t", "/foo/x"),
        ("{namespace}*", "/a*[b]/c", "/a\\*\\[b]/*"),
        ("[{name}", "/t", "\\[t"),
    ],
)
def test_placeholders(load, attachment, subject, expression) -> None:
    assert topics(load(profile(allow(attachment), attachment="*")), subject) == [expression]


@pytest.mark.parametrize(
    ("attachment", "code", "hint"),
    [
        ("{nam}", "brace", "did you mean '{name}'?"),
        ("{NAME}", "brace", "did you mean '{name}'?"),
        ("x}", "brace", "\\{ or \\}"),
        ("{", "brace", "\\{ or \\}"),
        ("{}", "brace", "\\{ or \\}"),
        ("[{name}]", "brace", "\\["),
        ("[@{T}]", "brace", "\\["),
        ("a\\", "expression", "\\\\"),
        ("[[:foo:]]", "expression", "alnum"),
        ("", "expression", "*"),
        ("@{T}", "tunable", "declare it"),
        ("x" * 5000, "expression", ""),
    ],
)
def test_wrong_attachments(refused, attachment, code, hint) -> None:
    found = refused(profile("\n", allow("/ok", attachment)))
    assert (found.code, found.where.line) == (code, 2)
    assert hint in found.help


def test_placeholders_are_not_for_profiles(refused) -> None:
    assert refused(profile(attachment="{namespace}x")).code == "brace"


def test_partitions_take_no_braces(refused, load) -> None:
    text = (
        '<topic qualifier="ALLOW"><attachment>x</attachment><permissions><publish/></permissions>'
        "<partitions><partition>{0}</partition></partitions></topic>"
    )
    assert refused(profile(text.replace("{0}", "{name}"))).code == "brace"
    assert load(profile(text.replace("{0}", "\\{a*"))).rules("/s")[0].partitions == ("\\{a*",)


@given(st.text(alphabet=" \t\n\\a*[]{}", max_size=6))
def test_text_of_a_name_survives_the_notation(text: str) -> None:
    written = escape(text)
    assert attachments.strip(f"\n {written}\t ") == written
    (value,) = attachments.expand(attachments.parse(written), lambda _: ())
    assert expression.literal("".join(value)) == text


@pytest.mark.parametrize(
    ("text", "pieces"),
    [
        ("", ()),
        ("/a*[^]b]", ("/a*[!\\]b]",)),
        ("a{name}b{namespace}@{T}", ("a", NAME, "b", NAMESPACE, TunableReference("T"))),
        ("\\@{T}", None),
        ("a@b", ("a@b",)),
        ("\\{name\\}", ("\\{name\\}",)),
    ],
)
def test_pieces(text, pieces) -> None:
    if pieces is None:
        with pytest.raises(ComArmorError, match="is unknown"):
            parse(text)
    else:
        assert parse(text) == pieces


@pytest.mark.parametrize(
    ("written", "kept"),
    [
        (" /a ", "/a"),
        ("/a\\ ", "/a\\ "),
        ("/a\\\\ ", "/a\\\\"),
        ("\n\t/a\\\t \n", "/a\\\t"),
        (" \\ ", "\\ "),
        (" ", ""),
    ],
)
def test_white_space_around_an_attachment_is_dropped_unless_it_is_escaped(written, kept) -> None:
    assert attachments.strip(written) == kept


VALUES = {"A": (("x",), ("/y/",)), "E": ((),), "N": ((NAME,), ("/",))}
PIECES = st.lists(st.sampled_from(["a", "/", "b/", "/c", *map(TunableReference, VALUES)]), max_size=5).map(tuple)


@given(PIECES)
def test_an_attachment_expands_to_every_combination_of_the_values(pieces) -> None:
    expanded = list(expand(pieces, VALUES.__getitem__))
    choices = [VALUES[piece.name] if isinstance(piece, TunableReference) else ((piece,),) for piece in pieces]
    combinations = ["".join(map("".join, choice)) for choice in product(*choices)]
    assert [single_slashes("".join(value)) for value in expanded] == [single_slashes(text) for text in combinations]


def single_slashes(text: str) -> str:
    return re.sub("/+", "/", text)


def test_limits_of_an_expansion() -> None:
    ten = tuple((str(digit),) for digit in range(10))
    most = (TunableReference("T"),) * 4
    assert len(list(expand(most, lambda _: ten))) == MOST_VALUES
    with pytest.raises(ComArmorError, match="100,000 combinations"):
        next(expand((*most, TunableReference("T")), lambda _: ten))
    long = (("x" * (MOST_CHARACTERS // 2 + 1),),)
    assert next(expand((TunableReference("T"),), lambda _: long)) == long[0]
    with pytest.raises(ComArmorError, match="longer than 4,096 characters"):
        next(expand((TunableReference("T"),) * 2, lambda _: long))


SUBJECTS = st.lists(st.text("ab*[]?\\{}", min_size=1, max_size=3), min_size=1, max_size=3).map(
    lambda names: "/" + "/".join(names)
)


@given(SUBJECTS)
def test_namespace_and_name_match_the_subject_itself_and_nothing_else(subject) -> None:
    value = (NAMESPACE, NAME)
    assert expression.literal(for_parts(value, *parts(subject))) == subject
    head, _, name = subject.rpartition("/")
    assert for_parts(value, escape(f"{head}/"), escape(name)) == for_parts(value, *parts(subject))


def test_parts_of_a_name_may_be_expressions() -> None:
    assert for_parts((NAMESPACE, "/x_", NAME), "/*/", "[ab]") == "/*/x_[ab]"
    assert for_parts((), "/*/", "a") == ""
