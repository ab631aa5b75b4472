# SPDX-License-Identifier: Apache-2.0
"""Both dialects of a policy, and its defects: each is reported with its place, the expected element and a hint."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import xmlschema
from lxml import etree

import comarmor
from comarmor import data

from .policies import allow, include, profile, profiles, topics, tunable


def test_both_dialects_even_mixed(load) -> None:
    policy = load(
        """<profile name="p"><attachments><attachment>/a</attachment><attachment>/b</attachment></attachments>
        <attachment> /c
        </attachment>
        <topic qualifier="DENY"><partitions><partition/></partitions><permissions><relay/><publish/></permissions>
          <attachment>x</attachment><attachments><attachment>y</attachment><attachment>x</attachment></attachments>
        </topic></profile>"""
    )
    assert policy.subjects() == ("/a", "/b", "/c")
    (rule,) = policy.rules("/c")
    assert rule.expressions == ("x", "y")
    assert rule.permissions == ("publish", "relay")
    assert rule.partitions == ("",)


def test_schema_is_accepted_by_both_validators(load) -> None:
    path = data.locate("comarmor", "schemas") / "comarmor.xsd"
    etree.XMLSchema(file=str(path))
    strict = xmlschema.XMLSchema(path)
    text = profiles(tunable("T", "x"), include("x.xml"), profile(allow("/@{T}"), include("y.xml")))
    assert strict.is_valid(text)
    assert not strict.is_valid(text.replace("qualifier", "qualifer"))


def test_comments_and_cdata_do_not_cut_a_name(load) -> None:
    assert load(profile(attachment="/tal<!-- no -->ker<?no?><![CDATA[2]]>")).subjects() == ("/talker2",)


def test_hints_where_a_schema_is_are_tolerated_at_the_root_only(load, refused) -> None:
    hint = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="file:///etc/passwd"'
    assert load(f"<profiles {hint}>{profile()}</profiles>").subjects() == ("/s",)
    assert refused(f"<profiles>{profile().replace(' name', f' {hint} name')}</profiles>").code == "schema"


@pytest.mark.parametrize(
    ("text", "line", "message", "hint"),
    [
        (
            "<profiles>\n<profil/></profiles>",
            2,
            "<profil> is not expected here, expected <profile>",
            "did you mean 'profile'?",
        ),
        (
            "<profiles>\n<profile\nname='p'>\n<attachment>/s</attachment></profile><x/></profiles>",
            4,
            "<x> is not expected",
            "",
        ),
        (
            profile(allow("/x").replace("</perm", "<ros_publsh/></perm")),
            1,
            "or <ros_relay>",
            "did you mean 'ros_publish'?",
        ),
        (
            profile(allow("/x").replace("ros_topic", "ros_action").replace("ros_publish", "ros_execute")),
            1,
            "expected <ros_request> or <ros_operate>",
            "did you mean 'ros_operate'?",
        ),
        (
            profile(allow("/x").replace("ros_topic", "ros_service").replace("ros_publish", "ros_request")),
            1,
            "expected <ros_call> or <ros_execute>",
            "did you mean 'ros_call'?",
        ),
        (profile(allow("{ns}x")), 1, "'{ns}' is unknown", "did you mean '{namespace}'?"),
        (profile(allow("/x"), "<attachment>/y</attachment>"), 1, "<attachment> is not expected here", "move it"),
        ("<policy/>", 1, "<policy> is not expected as the root, expected <profiles> or <profile>", ""),
        ('<profile\nname="p"/>', 1, "<profile> is not complete", ""),
        (
            profile("\n", re.sub("<permissions>.*</permissions>", "", allow("/x"))),
            2,
            "<ros_topic> is not complete, expected <permissions>",
            "",
        ),
        (
            '<profile name="p">\n<xi:include href="a.xml"/></profile>',
            2,
            "a prefix of this tag is not declared",
            'add xmlns:xi="http://www.w3.org/2001/XInclude" to the root element',
        ),
        (profile("\n", '<a:b href="a.xml"/>'), 2, "a prefix of this tag is not declared", "declare the prefix"),
        (
            '<profiles>\n<xi:include xmlns:xi="http://www.w3.org/2003/XInclude" href="a.xml"/></profiles>',
            2,
            "include> is not expected here",
            'the namespace of xi:include is "http://www.w3.org/2001/XInclude"',
        ),
        (
            '<profile name="p" modifer="AUDIT"><attachment>/s</attachment></profile>',
            1,
            "unknown attribute 'modifer'",
            "modifier",
        ),
        ("<profile><attachment>/s</attachment></profile>", 1, "<profile> lacks its attribute 'name'", ""),
        (profile("\n\n", allow("/x").replace("ALLOW", "allow")), 3, "expected ALLOW or DENY", "did you mean 'ALLOW'?"),
        (profile("text"), 1, "<profile> cannot contain text", "put the text"),
        (profile("\n", allow("/x").replace("ros_publish", "ros_call")), 2, "<ros_call> is not expected here", ""),
        (profile("\n", allow("/x").replace("<ros_publish/>", "")), 2, "<permissions> is not complete", ""),
        (profile("\n<topic/>"), 2, "<topic> lacks its attribute 'qualifier'", ""),
        (profile(attachment="<b/>"), 1, "can only contain text", ""),
        (profiles("\n", '<tunable name="a b"><value/></tunable>'), 2, "'a b'", ""),
        (profiles("\n", allow("/x")), 2, "<ros_topic> is not expected here", ""),
        ('<profiles xml:base="x"/>', 1, "unknown attribute 'xml:base'", ""),
        ('<profiles xmlns="urn:x"/>', 1, "not expected as the root", ""),
    ],
)
def test_schema_errors_say_what_was_expected(refused_any, text, line, message, hint) -> None:
    found = refused_any(text)
    assert message in found.message
    assert hint in found.help
    assert found.where.line == line
    if "expected <permissions>" in message:
        assert found.message == message


@pytest.fixture
def refused_any(write):
    """Load a policy that is refused, and return the first defect."""

    def _refused(text: str) -> comarmor.Diagnostic:
        with pytest.raises(comarmor.ComArmorError) as caught:
            comarmor.load(write({"policy.xml": text}))
        return caught.value.diagnostics[0]

    return _refused


def test_defect_in_an_included_file_has_its_origin(refused) -> None:
    found = refused(
        policy=profiles("\n\n", profile(include("sub/a.xml"))),
        sub__a=profile("\n", include("b.xml"), attachment="*"),
        sub__b="\n\n\n" + allow("/x").replace("ros_topic", "ros_topik"),
    )
    assert [Path(place.file).name for place in found.where.chain] == ["a.xml", "policy.xml"]
    assert [found.where.line, *(place.line for place in found.where.chain)] == [4, 2, 3]
    assert "included from" in str(found)
    assert found.help == "did you mean 'ros_topic'?"


def test_rules_cannot_stand_outside_of_a_profile(refused) -> None:
    assert refused(policy=profiles(include("sub/r.xml")), sub__r=allow("/x")).code == "rule-outside"
    assert refused(policy=allow("/x")).code == "rule-outside"


def test_all_defects_are_reported(write) -> None:
    root = write({"a.xml": profile(allow("{x}"), "\n", allow("{y}")), "b.xml": profile(attachment="no")})
    with pytest.raises(comarmor.ComArmorError) as caught:
        comarmor.load(root)
    assert [found.where.line for found in caught.value.diagnostics if found.where] == [1, 2, 1]


def test_lines_are_right_in_long_files(refused, write) -> None:
    text = profiles("\n" * 70_000, profile(), "\n", profile(allow("{x}")))
    assert refused(text).where.line == 70_002
    write({"policy.xml": text.replace("ros_publish", "ros_publsh").replace("{x}", "x")})
    assert refused(text.replace("ros_publish", "ros_publsh")).where.line == 70_002


@pytest.mark.parametrize(
    "name",
    [
        "talker",
        "//",
        "//a",
        "/a/",
        "/a//b",
        "/1a",
        "/a-b",
        "/a b",
        "/../x",
        "/a/..",
        "/é",
        "/a.b",
        "/" + "x" * 256,
        "/x" * 600,
    ],
)
def test_exact_subjects_have_legal_names(refused, name) -> None:
    found = refused(profile(profile("\n", attachment=name), attachment="*"))
    assert found.code == "subject-name"
    assert found.help


def test_legal_names(load) -> None:
    names = ("/a", "/A_1/_b", "/" + "x" * 255)
    policy = load(profiles(*(profile(attachment=name) for name in names)))
    assert policy.subjects() == tuple(sorted(names))


def test_an_included_file_means_the_same_in_every_profile_but_for_tunables_and_audit(load) -> None:
    uses = (include("own/uses.xml"), include("own/plain.xml"))
    policy = load(
        policy=profiles(
            profile(tunable("T", "/one"), *uses, attachment="/r/a"),
            profile(tunable("T", "/two"), *uses, attachment="/r/b", attributes=' modifier="AUDIT"'),
        ),
        own__uses=profiles(include("tunable.xml"), include("more.xml")),
        own__plain=profiles(include("rule.xml"), include("more.xml")),
        own__tunable=allow("@{T}"),
        own__rule=allow("/plain", "{namespace}x"),
        own__more=allow("{name}"),
    )
    assert topics(policy, "/r/a") == ["/one", "a", "/plain", "/r/x", "a"]
    assert topics(policy, "/r/b") == ["/two", "b", "/plain", "/r/x", "b"]
    assert {rule.audit for rule in policy.rules("/r/a")} == {False}
    assert {rule.audit for rule in policy.rules("/r/b")} == {True}
    for subject, written in zip(("/r/a", "/r/b"), policy.profiles, strict=True):
        places = [rule.origin for rule in policy.rules(subject)]
        assert places == [rule.where for rule in written.rules]
        files = [[each.file.rpartition("/")[2] for each in (place, *place.chain)] for place in places]
        more = [["more.xml", name, "policy.xml"] for name in ("uses.xml", "plain.xml")]
        of_rules = [["tunable.xml", "uses.xml", "policy.xml"], ["rule.xml", "plain.xml", "policy.xml"]]
        assert files == [of_rules[0], more[0], of_rules[1], more[1]]
        attached = [attachment.where for rule in written.rules for attachment in rule.attachments]
        assert {(place.file, place.chain) for place in attached} == {(place.file, place.chain) for place in places}
        assert {place.chain[-1].column for place in places} == {place.chain[-1].column for place in attached}


def test_a_defect_of_an_included_file_is_reported_at_each_inclusion(load) -> None:
    broken = allow("/x@{UNKNOWN}")
    with pytest.raises(comarmor.ComArmorError) as caught:
        load(
            policy=profiles(*(profile(include("own/broken.xml"), attachment=name) for name in ("/a", "/b"))),
            own__broken=broken,
        )
    assert [len(each.where.chain) for each in caught.value.diagnostics if each.where] == [1, 1]
