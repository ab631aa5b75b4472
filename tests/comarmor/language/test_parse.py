"""What a policy may be written like: dialects, includes, tunables, placeholders; and how what is wrong is said."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import xmlschema
from lxml import etree

import comarmor
from comarmor import data
from tests.effort import calls_of

XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'
REFERENCE = Path(__file__).parents[3] / "shared" / "reference" / "ppac" / "comarmor.d"


def include(href: str) -> str:
    return f'<xi:include href="{href}" parse="xml"/>'


def tunable(name: str, *values: str) -> str:
    return f'<tunable name="{name}">{"".join(f"<value>{value}</value>" for value in values)}</tunable>'


def allow(*attachments: str) -> str:
    listed = "".join(f"<attachment>{attachment}</attachment>" for attachment in attachments)
    return f'<ros_topic qualifier="ALLOW">{listed}<permissions><ros_publish/></permissions></ros_topic>'


def profile(*content: str, attachment: str = "/s") -> str:
    return f'<profile name="p" {XI}><attachment>{attachment}</attachment>{"".join(content)}</profile>'


def profiles(*content: str) -> str:
    return f"<profiles {XI}>{''.join(content)}</profiles>"


def topics(policy: comarmor.Policy, subject: str = "/s") -> list[str]:
    return [expression for rule in policy.rules(subject) for expression in rule.expressions]


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


def test_directory_has_its_roots_in_sorted_order(write) -> None:
    root = write(
        {
            "b.xml": profile(attachment="/b"),
            "a.xml": profile(include("sub/c.xml"), attachment="/a"),
            "sub/c.xml": allow("/c"),
            "sub/never.xml": "<broken",
            ".hidden.xml": "<broken",
            "d.xml/e": "a folder",
            "readme": "",
        }
    )
    policy = comarmor.load(root)
    assert [p.attachments[0].text for p in policy.profiles] == ["/a", "/b"]
    assert {path.name for path in policy.files} == {"a.xml", "b.xml", "c.xml"}
    assert all(len(digest) == 32 for digest in policy.files.values())
    assert comarmor.load(root / "a.xml").subjects() == ("/a",)


def test_union_of_policies(write) -> None:
    root = write({"a/x.xml": profile(attachment="/a"), "b/y.xml": profile(attachment="/b")})
    policy = comarmor.load_all([root / "a", root / "b" / "y.xml"])
    assert policy.subjects() == ("/a", "/b")
    assert len(policy.files) == 2


def test_library_has_what_the_policy_lacks(write, tmp_path) -> None:
    root = write({"p.xml": profile(include("common/node.xml"))})
    library = tmp_path / "library"
    (library / "common").mkdir(parents=True)
    (library / "common" / "node.xml").write_text(profile(include("part.xml"), attachment="*"))
    (library / "common" / "part.xml").write_text(allow("/x"))
    policy = comarmor.load(root, library=library)
    (rule,) = policy.rules("/s")
    assert str(rule.origin) == (
        f"{library}/common/part.xml:1, included from {library}/common/node.xml:1, included from {root}/p.xml:1"
    )
    (library / "common" / "part.xml").unlink()
    (root / "part.xml").write_text(profile(attachment="/y"))
    with pytest.raises(comarmor.ComArmorError, match="does not exist"):
        comarmor.load(root, library=library)
    (root / "common").mkdir()
    (root / "common" / "node.xml").write_text(allow("/own"))
    assert topics(comarmor.load(root, library=library)) == ["/own"]


# ---- placeholders ------------------------------------------------------------------------------------------------


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


# ---- tunables ------------------------------------------------------------------------------------------------------


def test_every_combination_of_tunables(load) -> None:
    policy = load(
        profiles(
            tunable("R", "/r1", "/r2"),
            tunable("N", "a", "b*"),
            profile(allow("{namespace}@{N}", "@{R}/@{R}"), attachment="@{R}/@{N}"),
        )
    )
    assert policy.subjects() == ("/r1/a", "/r2/a")
    assert topics(policy, "/r1/bb") == ["/r1/a", "/r1/b*", "/r1/r1", "/r1/r2", "/r2/r1", "/r2/r2"]


def test_doubled_slash_of_a_tunable_collapses_and_a_written_one_stays(load) -> None:
    text = profiles(tunable("N", "", "/r/"), profile(allow("/@{N}/x", "/a//@{N}x")))
    assert topics(load(text)) == ["/x", "/r/x", "/a//x", "/a//r/x"]


def test_value_is_an_expression_complete_in_itself(load) -> None:
    text = profiles(tunable("A", "[", "\\*"), tunable("B", "b]"), profile(allow("@{A}@{B}")))
    assert topics(load(text)) == ["\\[b]", "\\*b]"]


def test_value_may_use_other_tunables_and_placeholders(load) -> None:
    policy = load(profiles(tunable("A", "/a", "{namespace}"), tunable("B", "@{A}/b"), profile(allow("@{B}"))))
    assert topics(policy) == ["/a/b", "/b"]


def test_inner_tunable_hides_outer_one(load) -> None:
    policy = load(
        profiles(
            tunable("T", "/outer"),
            profile(tunable("T", "/inner"), allow("@{T}"), profile(allow("@{T}"))),
            profile(allow("@{T}"), attachment="/t"),
        )
    )
    assert topics(policy) == ["/inner", "/inner"]
    assert topics(policy, "/t") == ["/outer"]


@pytest.mark.parametrize(
    "inside",
    [
        (allow("@{T}"), tunable("T", "/inner")),
        (profile(allow("@{T}")), tunable("T", "/inner")),
        (profile(attachment="@{T}"), tunable("T", "/inner")),
        (tunable("U", "@{T}"), tunable("T", "/inner")),
        (include("sub/rule.xml"), tunable("T", "/inner")),
        (allow("@{T}"), include("sub/tunable.xml")),
        (profile(profile(allow("@{T}"))), profile(allow("/x"), tunable("T", "/here")), tunable("T", "/inner")),
    ],
)
def test_tunable_is_declared_before_its_use(refused, inside) -> None:
    found = refused(
        policy=profiles(tunable("T", "/s"), "\n", profile(*inside)),
        sub__rule=allow("@{T}"),
        sub__tunable=profiles(tunable("T", "/inner")),
    )
    assert found.code == "tunable"
    assert "declared after its use at" in found.message
    assert found.message.endswith("policy.xml:1")
    assert "above its use" in found.help


def test_profile_attachment_before_its_tunable(refused) -> None:
    attached = (
        '<profile name="p"><attachment>@{T}</attachment>\n<tunable name="T"><value>/b</value></tunable></profile>'
    )
    found = refused(profiles(tunable("T", "/a"), "\n", attached))
    assert found.code == "tunable"
    assert (found.where.line, "policy.xml:2," in found.message) == (3, True)


def test_uses_in_other_scopes_do_not_matter(load) -> None:
    policy = load(
        profiles(
            tunable("T", "/t"),
            profile(allow("@{T}")),
            profile(tunable("T", "/inner"), allow("@{T}"), attachment="/t"),
            profile(profile(tunable("T", "/a"), allow("@{T}")), tunable("T", "/b"), allow("@{T}")),
        )
    )
    assert topics(policy) == ["/t", "/b", "/a"]
    assert topics(policy, "/t") == ["/inner"]


def test_included_file_sees_the_scope_of_its_include_and_adds_to_it(load) -> None:
    policy = load(
        policy=profiles(
            include("sub/tunables.xml"),
            tunable("T", "/first"),
            profile(include("sub/rule.xml"), attachment="/a"),
            profile(tunable("T", "/second"), include("sub/rule.xml"), attachment="/b"),
            profile(allow("@{SHARED}"), attachment="@{SHARED}"),
        ),
        sub__tunables=profiles(tunable("SHARED", "/shared")),
        sub__rule=allow("@{T}"),
    )
    assert topics(policy, "/a") == ["/first"]
    assert topics(policy, "/b") == ["/second"]
    assert topics(policy, "/shared") == ["/shared"]


def test_scope_ends_with_its_element(refused) -> None:
    found = refused(
        policy=profiles(profile(include("sub/t.xml")), profile(allow("@{T}"))), sub__t=profiles(tunable("T", "x"))
    )
    assert found.code == "tunable"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ((tunable("T", "x"), tunable("T", "x")), "declared twice"),
        ((tunable("T", "a@{T}"),), "refers to itself"),
        ((tunable("T", "x"), profile(tunable("T", "@{T}"))), "refers to itself"),
        ((tunable("A", "@{B}"), tunable("B", "@{A}")), "unknown"),
        ((profile(allow("@{T}")), tunable("T", "x")), "unknown"),
        ((tunable("ROBOT", "x"), profile(allow("@{ROBOTS}"))), "unknown"),
        ((tunable("T", "{oops}"),), "'{oops}' is unknown"),
        ((tunable("T", "\\"),), "lone"),
        ((tunable("T", ""), profile(allow("@{T}"))), "empty"),
        ((tunable("T", "1x"), profile(attachment="/@{T}")), "legal name"),
    ],
)
def test_wrong_tunables(refused, content, message) -> None:
    found = refused(profiles("\n", "\n".join(content)))
    assert message in found.message
    assert found.where.line > 1


def test_unknown_tunable_is_asked_back(refused) -> None:
    assert refused(profiles(tunable("ROBOT", "x"), profile(allow("@{ROBOTS}")))).help == "did you mean 'ROBOT'?"


def test_tunables_cannot_explode(refused) -> None:
    doubling = [tunable(f"T{i}", f"@{{T{i - 1}}}@{{T{i - 1}}}") for i in range(1, 40)]
    found, calls = calls_of(lambda: refused(profiles(tunable("T0", "a", "b"), *doubling)))
    assert found.code == "tunable"
    assert calls < 500_000


# ---- what is wrong, and where --------------------------------------------------------------------------------------


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
        (profile("text"), 1, "<profile> cannot contain text", "comment"),
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
        "/",
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


def test_nothing_to_load(tmp_path) -> None:
    for path, code in ((tmp_path, "policy-empty"), (tmp_path / "x", "policy-missing"), (Path("\0"), "policy-missing")):
        with pytest.raises(comarmor.ComArmorError) as caught:
            comarmor.load(path)
        assert caught.value.diagnostics[0].code == code


# ---- size ----------------------------------------------------------------------------------------------------------


def test_a_thousand_profiles_load_and_are_looked_up_quickly(load) -> None:
    many = "".join(profile(*(allow(f"/t{i}/{j}") for j in range(10)), attachment=f"/r/p{i}") for i in range(1000))
    policy = load(profiles(many, profile(attachment="*")))
    subjects = policy.subjects()
    rules, calls = calls_of(lambda: sum(len(policy.rules(subject)) for subject in subjects))
    assert rules == 10_000
    assert calls < 200 * rules


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference material is not here")
def test_policy_of_the_field() -> None:
    policy = comarmor.load(REFERENCE)
    assert policy.subjects() == ("/listener", "/talker")
    assert policy.decide("/talker", "ros_topic", "ros_publish", "/chatter").allowed
    assert not policy.decide("/talker", "ros_topic", "ros_subscribe", "/chatter").allowed
    assert policy.decide("/listener", "ros_service", "ros_call", "/listener/get_parameters").allowed
