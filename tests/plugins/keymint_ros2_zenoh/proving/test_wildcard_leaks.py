# SPDX-License-Identifier: Apache-2.0
"""Key expressions that carry a message around a denial: those that are found do, and none is missed."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_zenoh.keyexpr import KeyExpr, KeyExprError, canonical, includes, intersects, parse
from keymint_ros2_zenoh.proving.shared_proof import Leak, Rights, leaks, wider

from tests.effort import tries


def rights(subject: str, allowed: list[str], denied: list[str] | None = None) -> Rights:
    return Rights(subject, tuple(map(parse, allowed)), tuple(map(parse, denied or [])))


def found(sent: Rights, *received: Rights) -> list[Leak]:
    return list(leaks([sent], received))


@pytest.mark.parametrize(
    ("allowed", "denied", "received", "leaking"),
    [
        ("0/**", "0/secret/x/*/*", "0/**", True),
        ("0/*/*/*", "0/secret/*/*", "0/*/*/*", True),
        ("0/*/*/*", "0/secret/*/*", "0/se$*/*/*", True),
        ("0/*/*/*", "0/secret/*/*", "0/secret/*/*", False),
        ("0/*/*/*", "0/secret/*/*", "0/public$*/*/*", False),
        ("0/a/*/*/*", "0/a/b/*/*", "0/*/b/*/*", False),
        ("0/a/*/*/*", "0/a/b/*/*", "0/**/b/*/*", False),
        ("0/$*b/*/*", "0/ab/*/*", "0/a$*/*/*", True),
        ("0/secret/*/*", "0/secret/*/*", "0/**", False),
        ("0/*/t/h/@adv/**", "0/x/t/h/@adv/**", "0/$*x/*/*/@adv/**", True),
    ],
)
def test_whether_a_message_passes(allowed: str, denied: str, received: str, leaking: bool) -> None:
    leak = found(rights("/s", [allowed], [denied]), rights("/r", [received]))
    assert bool(leak) is leaking
    for each in leak:
        assert each.key is not None
        assert (each.sender, each.receiver, each.denied.text) == ("/s", "/r", denied)


def test_what_the_receiver_is_denied_does_not_arrive() -> None:
    sent = rights("/s", ["0/*/*/*"], ["0/secret/*/*"])
    leak = found(sent, rights("/r", ["0/secret$*/*/*"], ["0/secret$*/*/*"]))
    assert [each.key for each in leak] == [None]
    assert not found(sent, rights("/r", ["0/secret/*/*"], ["0/x/*/*"]))


def test_the_sender_itself_is_no_receiver() -> None:
    both = rights("/s", ["0/*/*/*"], ["0/secret/*/*"])
    assert not found(both, both)
    assert [each.receiver for each in found(both, both, rights("/r", ["0/*/*/*"], ["0/secret/*/*"]))] == ["/r"]


def test_one_leak_for_each_denial() -> None:
    sent = rights("/s", ["0/*/*/*"], ["0/a/*/*", "0/b/*/*"])
    leak = found(sent, rights("/r", ["0/*/*/*"]), rights("/q", ["0/**"]))
    assert [each.denied.text for each in leak] == ["0/a/*/*", "0/b/*/*"]


CHUNKS = ("a", "b", "ab", "*", "**", "a$*", "$*b", "$*a$*")


def every_key_expr(length: int) -> list[KeyExpr]:
    all_of_them = set()
    for size in range(1, length + 1):
        for chunks in product(CHUNKS, repeat=size):
            all_of_them.add(canonical("/".join(chunks)))
    return sorted(all_of_them)


NAMES = every_key_expr(3)
texts = st.lists(st.sampled_from(CHUNKS), min_size=1, max_size=2).map("/".join).map(canonical)
plain = st.lists(st.sampled_from(("a", "b", "ab")), min_size=1, max_size=2).map("/".join).map(parse)


def keyed(name: KeyExpr) -> str:
    return canonical(f"0/{name.text}/*/*").text


@settings(max_examples=tries(75, 150), deadline=None)
@given(texts, plain, texts)
def test_no_way_around_a_denied_name_is_missed(allowed: KeyExpr, denied: KeyExpr, received: KeyExpr) -> None:
    sent = rights("/s", [keyed(allowed)], [keyed(denied)])
    leak = found(sent, rights("/r", [keyed(received)]))
    ways = [
        key
        for key in (parse(keyed(name)) for name in NAMES)
        if includes(sent.allowed[0], key) and intersects(key, sent.denied[0]) and not includes(sent.denied[0], key)
        and includes(parse(keyed(received)), key)
    ]  # fmt: skip
    if ways:
        assert leak, ways[0]
    for each in leak:
        key = each.key
        assert key is not None
        assert includes(sent.allowed[0], key)
        assert includes(parse(keyed(received)), key)
        assert intersects(key, sent.denied[0])
        assert not includes(sent.denied[0], key)


@given(texts)
def test_wider_expressions_meet_and_are_not_included(denied: KeyExpr) -> None:
    for each in wider(denied):
        assert intersects(each, denied)
        assert not includes(denied, each)


def test_an_insertion_never_makes_an_illegal_expression() -> None:
    with pytest.raises(KeyExprError):
        parse("a$$**")
    assert {each.text for each in wider(parse("0/a$*"))} >= {"0/$*a$*", "**/0/a$*"}
