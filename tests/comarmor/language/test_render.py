# SPDX-License-Identifier: Apache-2.0
"""The canonical form: it decides as the policy does, and is its own canonical form."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import xmlschema
from hypothesis import given, settings, strategies as st

import comarmor
from comarmor import PERMISSIONS, Attachment, Effect, Origin, Policy, Profile, ProfileRule, data
from comarmor.language import attachments
from tests.effort import tries

HERE = Origin("generated.xml", 1)
PIECES = (
    "/",
    "a",
    "b",
    "*",
    "?",
    "[ab]",
    "[!a]",
    "[\\{-\\}]",
    "{name}",
    "{namespace}",
    "\\*",
    "\\{",
    "\\ ",
    "&amp;",
    "<é>",
)
RULE_TEXTS = st.lists(st.sampled_from(PIECES), min_size=1, max_size=4).map("".join)
PROFILE_TEXTS = st.sampled_from(["/a", "/a/b", "/b", "*", "/a*", "*/b", "/?", "/[ab]"])
NAMES = ("/a", "/a/b", "/b", "/c", "a", "", "/a*", "/{", "/ ", "/a/get_parameters", "/a/_action/status")


def expressions(texts: st.SearchStrategy[str]) -> st.SearchStrategy[tuple[Attachment, ...]]:
    def read(text: str) -> Attachment:
        return Attachment.of(next(attachments.expand(attachments.parse(text), lambda _: ())), HERE)

    return st.lists(texts.map(read), min_size=1, max_size=3, unique_by=lambda item: item.text).map(tuple)


@st.composite
def rules(draw: st.DrawFn) -> ProfileRule:
    kind = draw(st.sampled_from(list(PERMISSIONS)))
    held = draw(st.sets(st.sampled_from(PERMISSIONS[kind]), min_size=1))
    partitions = (
        draw(st.lists(st.sampled_from(["", "p*", "q", "\\ "]), max_size=2, unique=True)) if kind == "topic" else []
    )
    return ProfileRule(
        draw(st.sampled_from(Effect)),
        kind,
        tuple(permission for permission in PERMISSIONS[kind] if permission in held),
        draw(expressions(RULE_TEXTS)),
        tuple(partitions),
        draw(st.booleans()),
        HERE,
    )


def profiles(depth: int) -> st.SearchStrategy[Profile]:
    inner = st.lists(profiles(depth - 1), max_size=2).map(tuple) if depth else st.just(())
    return st.builds(
        Profile,
        name=st.sampled_from(["", "p", '"<\n>']),
        audit=st.booleans(),
        attachments=expressions(PROFILE_TEXTS),
        profiles=inner,
        parts=st.lists(rules(), max_size=3).map(tuple),
        where=st.just(HERE),
    )


def reload(text: str) -> Policy:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.xml"
        path.write_bytes(text.encode())
        return comarmor.load(path)


@functools.cache
def schema() -> xmlschema.XMLSchema:
    return xmlschema.XMLSchema(data.locate("comarmor", "schemas") / "comarmor.xsd")


def watched(profiles_: tuple[Profile, ...]) -> bool:
    return any(profile.audit or watched(profile.profiles) for profile in profiles_)


@settings(max_examples=tries(20, 40), deadline=None)
@given(st.lists(profiles(2), max_size=3).map(tuple).map(Policy))
def test_round_trip(policy: Policy) -> None:
    text = comarmor.render(policy)
    schema().validate(text)
    loaded = reload(text)
    again = comarmor.render(loaded)
    assert comarmor.render(reload(again)) == again
    if not watched(policy.profiles):  # in the canonical form the rules of a watched profile are marked themselves
        assert again == text
    assert loaded.subjects() == policy.subjects()
    for subject in ("/a", "/a/b", "/c"):
        for kind, permissions in PERMISSIONS.items():
            for permission in permissions:
                for name in NAMES:
                    for partitions in ((), ("p1", "q")):
                        one = policy.decide(subject, kind, permission, name, partitions)
                        two = loaded.decide(subject, kind, permission, name, partitions)
                        assert one.effect is two.effect
                        assert bool(one.rules) == bool(two.rules)


def test_canonical_form(load) -> None:
    policy = load(
        """<profile name="p" modifier="AUDIT"><tunable name="T"><value>x</value><value>[^]]</value></tunable>
        <attachments><attachment>/s</attachment></attachments>
        <topic qualifier="ALLOW"><permissions><subscribe/><publish/></permissions>
        <partitions><partition/></partitions><attachment>@{T}\\y{name}</attachment></topic></profile>"""
    )
    assert comarmor.render(policy) == (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        "<profiles>\n"
        '  <profile name="p" modifier="AUDIT">\n'
        "    <attachment>/s</attachment>\n"
        '    <topic qualifier="ALLOW" modifier="AUDIT">\n'
        "      <attachment>xy{name}</attachment>\n"
        "      <attachment>[!\\]]y{name}</attachment>\n"
        "      <permissions><publish/><subscribe/></permissions>\n"
        "      <partitions>\n        <partition></partition>\n      </partitions>\n"
        "    </topic>\n"
        "  </profile>\n"
        "</profiles>\n"
    )
