# SPDX-License-Identifier: Apache-2.0
"""``permissions.xml``: the same rules as the intermediate representation, or those of an edit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st
from keymint_ros import package_type, permissions

from comarmor.errors import Origin
from comarmor.rules import PERMISSIONS, Effect
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules

from .workspaces import RULES, Workspace, load_package, rules

# Text that an XML document can contain, without surrounding white space, which no expression of a policy has.
_CHARACTERS = st.characters(codec="utf-8", exclude_categories=["Cc", "Cs", "Cn"], include_characters="\t\n\r")
_TEXT = st.text(_CHARACTERS, min_size=1, max_size=12).filter(lambda text: text == text.strip(" \t\r\n"))
_EXPRESSIONS = _TEXT.filter(lambda text: not text.endswith("\\"))
_FILES = st.text(st.characters(codec="utf-8", exclude_characters="\0/"), min_size=1, max_size=8).filter(
    lambda name: name not in {".", ".."}
)
_FOLDERS = st.sampled_from(["/ws/profile/comarmor.d/", "/ws/profile/", "/other/", "package://nav2_bringup/"])
_PLACES = st.builds(lambda folder, file, line: Origin(folder + file, line), _FOLDERS, _FILES, st.integers(0, 10**6))
_ORIGINS = st.builds(
    lambda place, chain: Origin(place.file, place.line, tuple(chain)), _PLACES, st.lists(_PLACES, max_size=2)
)


@st.composite
def _rules(draw: st.DrawFn) -> Rule:
    kind = draw(st.sampled_from(sorted(PERMISSIONS)))
    return Rule(
        effect=draw(st.sampled_from(Effect)),
        kind=kind,
        permissions=tuple(draw(st.lists(st.sampled_from(PERMISSIONS[kind]), min_size=1, unique=True))),
        expressions=tuple(draw(st.lists(_EXPRESSIONS, min_size=1, max_size=3))),
        partitions=tuple(draw(st.lists(_EXPRESSIONS | st.just(""), max_size=2))) if kind == "topic" else (),
        audit=draw(st.booleans()),
        origin=draw(_ORIGINS),
    )


_SUBJECTS = st.lists(_rules(), max_size=4).map(lambda drawn: SubjectRules("/robot1/talker", tuple(drawn)))
_WORKSPACE = Workspace.new()


@given(_SUBJECTS)
def test_created_rules_are_loaded_unchanged(rules_: SubjectRules) -> None:
    profile = _WORKSPACE.load_profile()
    files = package_type.create(profile, rules_, {}, force=False)
    assert load_package(profile, "robot1/talker", "src", files).grant.rules == rules_
    assert load_package(profile, "robot1/talker", "src", _read_again(files)).grant.rules == rules_
    assert package_type.create(profile, rules_, files, force=False) == {}


_NEAR_PLAIN = st.text(st.sampled_from("/a*\\ ]>&{-\x7f\n"), min_size=0, max_size=5)
_ANY_PLACES = st.builds(
    lambda folder, file, line, column: Origin(folder + file, line, (), column),
    st.sampled_from(["/ws/profile/", "/ws/profile/../x/", "/ws/profile", "", "/"]),
    st.text(st.sampled_from("a.;:%<> /\n"), min_size=1, max_size=4),
    st.integers(0, 99),
    st.integers(0, 9),
)


@given(
    st.lists(st.lists(_NEAR_PLAIN, min_size=1, max_size=2), max_size=3),
    st.lists(_NEAR_PLAIN, max_size=1),
    _ANY_PLACES,
    st.lists(_ANY_PLACES, max_size=2),
)
def test_a_package_from_rules_of_this_run_is_the_one_that_is_read(
    expressions: list[list[str]], partitions: list[str], place: Origin, around: list[Origin]
) -> None:
    origin = Origin(place.file, place.line, tuple(around), place.column)
    rules_ = SubjectRules(
        "/robot1/talker",
        tuple(
            Rule(
                Effect.DENY,
                "topic",
                ("relay", "publish"),
                tuple(own),
                tuple(partitions),
                audit=bool(number),
                origin=origin,
            )
            for number, own in enumerate(expressions)
        ),
    )
    profile = _WORKSPACE.load_profile()
    files = package_type.create(profile, rules_, {}, force=False)
    outcomes = []
    for each in (files, _read_again(files)):
        try:
            outcomes.append(load_package(profile, "robot1/talker", "src/robot1/talker", each))
        except KeymintError as error:
            outcomes.append(error.diagnostics)
    assert outcomes[0] == outcomes[1]


def _read_again(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the files with a document of the same meaning that is not the one which was written."""
    return {**files, "permissions.xml": files["permissions.xml"] + b"\n"}


@given(_SUBJECTS, _SUBJECTS)
def test_an_unedited_document_follows_the_policy(before: SubjectRules, after: SubjectRules) -> None:
    profile = _WORKSPACE.load_profile()
    files = package_type.create(profile, before, {}, force=False)
    changed = {**files, **package_type.create(profile, after, files, force=False)}
    loaded = load_package(profile, "robot1/talker", "src", changed).grant.rules
    assert [(rule.effect, rule.kind, rule.expressions) for rule in loaded.rules] == [
        (rule.effect, rule.kind, rule.expressions) for rule in after.rules
    ]
    assert package_type.create(profile, after, changed, force=False) == {}


def test_the_digest_depends_neither_on_order_nor_on_origins() -> None:
    def digest(rules_: SubjectRules) -> str:
        content = package_type.create(_WORKSPACE.load_profile(), rules_, {}, force=False)["permissions.xml"]
        match = re.search(r'digest="(.*?)"', content.decode())
        assert match
        return match.group(1)

    assert digest(SubjectRules(RULES.subject, RULES.rules[::-1])) == digest(RULES)
    assert digest(rules("/a", line=7)) == digest(rules("/a", line=8))
    assert digest(rules("/a")) != digest(rules("/b"))


def test_rules_of_an_edited_document_come_from_that_document() -> None:
    before = _WORKSPACE.load().grant.rules.rules
    assert [rule.origin for rule in before] == [rule.origin for rule in RULES.rules]
    edited = _WORKSPACE.edit("permissions.xml", "/robot1/chatter", "/robot1/other")
    after = edited.load().grant.rules.rules
    assert after[0].expressions == ("/robot1/other",)
    assert [str(rule.origin) for rule in after] == [
        "src/robot1/talker/permissions.xml:7",
        "src/robot1/talker/permissions.xml:11",
    ]


def test_a_grant_overrides_the_defaults() -> None:
    edited = _WORKSPACE.edit(
        "permissions.xml",
        '<grant name="/robot1/talker">',
        """<grant name="mine">
             <domains><id>3</id><id_range><min>5</min><max>7</max></id_range></domains>
             <subject_name>CN={name}</subject_name>
             <validity><not_before>2026-01-01T00:00:00</not_before><duration>P1M</duration></validity>""",
    )
    grant = edited.load().grant
    assert grant.name == "mine"
    assert [(domain.first, domain.last) for domain in grant.domains] == [(3, 3), (5, 7)]
    assert grant.subject_name == "CN=robot1/talker"
    assert grant.validity.not_after.isoformat() == "2026-02-01T00:00:00+00:00"
    assert [rule.origin for rule in grant.rules.rules] == [rule.origin for rule in RULES.rules]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("/robot1/chatter<", "<", "attachment is empty"),
        ("/robot1/chatter<", "{namespace}chatter<", "expanded in this document"),
        ("/robot1/chatter<", "@{ROBOT}/chatter<", "expanded in this document"),
        ("/robot1/chatter<", "/robot1/chatter\\<", "\\"),
        ("<attachment>/robot1/chatter</attachment>", "", "attachment"),
        ("<ros_publish/>", "<ros_publsh/>", "ros_publish"),
        ('qualifier="ALLOW"', 'qualifier="ALOW"', "ALLOW"),
        ("format=", "formt=", "formt"),
        ("</grant>", '</grant><grant name="b"/>', "grant"),
        ("<partitions>", "<partitons>", "partitons"),
    ],
)
def test_a_defect_is_reported_with_its_line(old: str, new: str, message: str) -> None:
    with pytest.raises(KeymintError) as error:
        _WORKSPACE.edit("permissions.xml", old, new).load()
    diagnostic = error.value.diagnostics[0]
    assert diagnostic.where
    assert diagnostic.where.file == "src/robot1/talker/permissions.xml"
    assert diagnostic.where.line > 3
    assert message in f"{diagnostic}"
    assert "\n" not in str(diagnostic)


@pytest.mark.parametrize("base", ["", "profile/", "../ws/profile/", "/ws/profile/"])
def test_a_file_that_a_package_ships_is_named_alike_from_every_folder(base: str) -> None:
    where = Origin("package://nav2_bringup/a.xml", 3)
    document = permissions.render(SubjectRules("/a", (replace(RULES.rules[0], origin=where),)), base).decode()
    (stated,) = re.findall('origin="(.*?)"', document)
    assert stated == "package://nav2_bringup/a.xml:3"
    origin = permissions.parse_origin(stated)
    assert origin is not None
    assert permissions.origin_in_folder(base, origin) == where
