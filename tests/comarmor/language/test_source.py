# SPDX-License-Identifier: Apache-2.0
"""Includes are confined to the policy's folder, and bounded: attacks by somebody who may edit a policy."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import comarmor
from comarmor.data import locate
from comarmor.errors import ComArmorError
from comarmor.language import source
from comarmor.xml.reader import Limits
from tests.effort import calls_of

LIBRARY = locate("keymint_ros", "templates") / "comarmor.d" / "iron"
XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'


def including(*hrefs: str) -> str:
    includes = "".join(f'<xi:include href="{href}"/>' for href in hrefs)
    return f"<profiles {XI}>{includes}</profiles>"


PROFILE = '<profile name="p"><attachment>/s</attachment></profile>'


def quickly_refused(path: Path) -> comarmor.Diagnostic:
    def refused() -> comarmor.Diagnostic:
        with pytest.raises(ComArmorError) as caught:
            comarmor.load(path)
        return caught.value.diagnostics[0]

    found, calls = calls_of(refused)
    assert calls < 100_000
    return found


def test_total_limits(write) -> None:
    root = write({"a.xml": including("s/b.xml"), "s/b.xml": "<profiles/>"})
    with pytest.raises(ComArmorError, match="bytes allowed"):
        source.load_tree(root, limits=Limits(total_bytes=100))
    with pytest.raises(ComArmorError, match="elements"):
        source.load_tree(root, limits=Limits(nodes=2))


@pytest.mark.parametrize(
    ("href", "code"),
    [
        ("/etc/passwd", "include-outside"),
        ("file:///etc/passwd", "include-href"),
        ("http://127.0.0.1:9/x.xml", "include-href"),
        ("//127.0.0.1/x.xml", "include-href"),
        ("../outside.xml", "include-outside"),
        ("sub/../../outside.xml", "include-outside"),
        ("%2e%2e/outside.xml", "include-outside"),
        ("../policy-next/p.xml", "include-outside"),
        ("%00", "include-href"),
        ("", "include-href"),
        ("#x", "include-href"),
        ("sub/ok.xml#x", "include-href"),
        ("sub/ok.xml?x", "include-href"),
        ("http://[", "include-href"),
        (".", "unreadable"),
        ("sub", "unreadable"),
        ("sub/ok.xml/x", "include-missing"),
        ("sub/okay.xml", "include-missing"),
        ("x" * 5000, "unreadable"),
        ("p.xml", "include-loop"),
    ],
)
def test_includes_stay_inside(write, tmp_path, href, code) -> None:
    root = write({"p.xml": f"\n{including(href)}", "sub/ok.xml": PROFILE})
    (tmp_path / "outside.xml").write_text(PROFILE)
    (tmp_path / "policy-next").mkdir()
    (tmp_path / "policy-next" / "p.xml").write_text(PROFILE)
    found = quickly_refused(root / "p.xml")
    assert found.code == code
    assert str(found.where) == f"{root}/p.xml:2"


def test_a_missing_include_says_where_it_was_looked_for(write, tmp_path) -> None:
    root = write({"p.xml": including("s/nod.xml"), "s/node.xml": PROFILE})
    found = quickly_refused(root / "p.xml")
    assert "'s/nod.xml' does not exist" in found.message
    assert found.help == f"looked for '{root}/s/nod.xml'; did you mean 'node.xml'?"


def test_a_missing_include_is_not_advised_to_be_the_including_file(write) -> None:
    root = write({"p.xml": including("o.xml")})
    found = quickly_refused(root / "p.xml")
    assert found.help == f"looked for '{root}/o.xml'"


def test_and_in_the_library_as_well(write, tmp_path) -> None:
    root = write({"p.xml": including("s/nod.xml")})
    library = tmp_path / "library"
    (library / "s").mkdir(parents=True)
    (library / "s/node.xml").write_text(PROFILE)
    with pytest.raises(comarmor.ComArmorError) as caught:
        comarmor.load(root / "p.xml", library=library)
    help_ = caught.value.diagnostics[0].help
    assert help_ == f"looked for '{root}/s/nod.xml' and '{library}/s/nod.xml'; did you mean 'node.xml'?"


@pytest.mark.parametrize("target", ["/etc/passwd", "../outside.xml", "missing", "sub", "link.xml", "/dev/zero"])
@pytest.mark.parametrize("link", ["link.xml", "sub/link.xml"])
def test_symbolic_links_do_not_lead_outside(write, tmp_path, target, link) -> None:
    root = write({"p.xml": including(link), "sub/ok.xml": PROFILE})
    (tmp_path / "outside.xml").write_text(PROFILE)
    (root / link).symlink_to(target)
    assert quickly_refused(root / "p.xml").code in {"include-outside", "include-missing", "unreadable"}
    if link == "link.xml":
        assert quickly_refused(root).code in {"include-outside", "include-missing", "unreadable"} or target == "sub"


def test_linked_folder_does_not_lead_outside(write, tmp_path) -> None:
    root = write({"p.xml": including("dir/x.xml")})
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "x.xml").write_text(PROFILE)
    (root / "dir").symlink_to(tmp_path / "other")
    assert quickly_refused(root).code == "include-outside"


def test_links_inside_are_followed(write) -> None:
    root = write({"p.xml": including("sub/link.xml"), "sub/ok.xml": PROFILE})
    (root / "sub" / "link.xml").symlink_to("ok.xml")
    assert comarmor.load(root).subjects() == ("/s",)


def test_linked_policy_has_its_includes_beside_the_real_file(write, tmp_path) -> None:
    root = write({"p.xml": including("sub/ok.xml"), "sub/ok.xml": PROFILE})
    (tmp_path / "link.xml").symlink_to(root / "p.xml")
    assert comarmor.load(tmp_path / "link.xml").subjects() == ("/s",)


def test_named_pipe_does_not_hold_the_tool_up(write) -> None:
    root = write({"p.xml": including("sub/pipe"), "sub/ok.xml": PROFILE})
    os.mkfifo(root / "sub" / "pipe")
    assert "not a regular file" in quickly_refused(root).message


def test_loops(write) -> None:
    root = write({"p.xml": including("s/a.xml"), "s/a.xml": including("b.xml"), "s/b.xml": f"\n{including('a.xml')}"})
    found = quickly_refused(root)
    assert found.code == "include-loop"
    assert [place.line for place in (found.where, *found.where.chain)] == [2, 1, 1]


RULE = '<ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>'
USES = RULE.replace("/x", "/@{T}")
TUNABLE = '<tunable name="T"><value>x</value></tunable>'
PROFILES = 40


@pytest.mark.parametrize(
    ("files", "each"),
    [
        ({"s/a.xml": RULE}, 0),
        ({"s/a.xml": including("b.xml", "b.xml"), "s/b.xml": RULE}, 2 / PROFILES),
        ({"s/a.xml": f"<profiles>{TUNABLE.replace('T', 'U')}</profiles>"}, 1),
        ({"s/a.xml": USES}, 1),
        ({"s/a.xml": including("b.xml", "c.xml"), "s/b.xml": USES, "s/c.xml": RULE}, 3),
    ],
    ids=["a rule", "nested rules", "declares", "uses", "nested"],
)
def test_an_inclusion_counts_if_it_reads_the_file_again(write, files: dict[str, str], each: float) -> None:
    one = '<profile name="p"><attachment>/s{}</attachment><xi:include href="s/a.xml"/></profile>'
    root = write({"p.xml": f"<profiles {XI}>{TUNABLE}{''.join(map(one.format, range(PROFILES)))}</profiles>", **files})
    assert len(comarmor.load(root).profiles) == PROFILES
    source.load_tree(root, limits=Limits(inclusions=int(each * PROFILES)))
    if each:
        with pytest.raises(ComArmorError, match="inclusions allowed"):
            source.load_tree(root, limits=Limits(inclusions=int(each * PROFILES) - 1))


def test_many_subjects_include_the_library_s_rules(write) -> None:
    one = '<profile name="p"><attachment>/s{}</attachment><xi:include href="common/node.xml"/></profile>'
    root = write({"p.xml": f"<profiles {XI}>{''.join(map(one.format, range(12_000)))}</profiles>"})
    assert len(comarmor.load(root, library=LIBRARY).subjects()) == 12_000


@pytest.mark.parametrize("width", [2, 10])
@pytest.mark.parametrize("depth", [15, 16, 60])
def test_doublings(write, width, depth) -> None:
    files = {f"s/{i}.xml": including(*[f"{i + 1}.xml"] * width) for i in range(depth)}
    root = write({"p.xml": including("s/0.xml"), **files, f"s/{depth}.xml": PROFILE})
    assert quickly_refused(root).code == "xml-limit"


@pytest.mark.parametrize("order", ["ab", "ba"])
def test_includes_are_relative_to_the_name_by_which_a_file_is_included(write, order: str) -> None:
    """And not to another name that links give the same file, whichever is included first."""
    files = {f"{name}/y.xml": RULE.replace("/x", f"/from_{name}") for name in "ab"}
    included = "".join(f'<xi:include href="{name}/x.xml"/>' for name in order)
    profile = f'<profile name="p" {XI}><attachment>/s</attachment>{included}</profile>'
    root = write({"p.xml": profile, "b/x.xml": including("y.xml"), **files})
    (root / "a/x.xml").symlink_to("../b/x.xml")
    (found,) = comarmor.load(root).profiles
    assert [rule.attachments[0].text for rule in found.rules] == [f"/from_{name}" for name in order]


def climbing(write, *names: str, link: str, linked: str) -> Path:
    """Write a policy that includes a file by names of its folder; the file includes one that includes ``../y.xml``."""
    included = "".join(f'<xi:include href="{name}/x.xml"/>' for name in names)
    profile = f'<profile name="p" {XI}><attachment>/s</attachment>{included}</profile>'
    files = {"sub/y.xml": RULE, "y.xml": RULE.replace("/x", "/other"), "sub/deep/z.xml": including("../y.xml")}
    root = write({"p.xml": profile, "sub/deep/x.xml": including("z.xml"), **files})
    (root / link).symlink_to(linked)
    return root


@pytest.mark.parametrize("names", [("sub/deep", "link"), ("link", "sub/deep")])
def test_a_way_up_out_of_a_linked_folder_is_refused_if_names_differ_in_it(write, names: tuple[str, str]) -> None:
    """Else both names would have the rules of the one that comes first."""
    root = climbing(write, *names, link="link", linked="sub/deep")
    found = quickly_refused(root / "p.xml")
    assert (found.code, str(found.where)) == ("include-ambiguous", f"{root}/p.xml:1")
    assert f"'{root}/{names[0]}/x.xml'" in found.message


@pytest.mark.parametrize(
    ("names", "link", "linked", "rules"),
    [
        (("link",), "link", "sub/deep", ["/other"]),
        (("sub/deep",), "link", "sub/deep", ["/x"]),
        (("sub/deep", "sub/link"), "sub/link", "deep", ["/x", "/x"]),
    ],
)
def test_a_way_up_is_that_of_the_name(write, names: tuple[str, ...], link: str, linked: str, rules: list[str]) -> None:
    (found,) = comarmor.load(climbing(write, *names, link=link, linked=linked) / "p.xml").profiles
    assert [rule.attachments[0].text for rule in found.rules] == rules


@pytest.mark.parametrize("leaf", [RULE, PROFILE])
def test_names_that_links_multiply_are_refused_quickly(write, leaf: str) -> None:
    links = [f"d{i}" for i in range(10)]
    files = {f"s/{i}.xml": including(*(f"{link}/{i + 1}.xml" for link in links)) for i in range(14)}
    root = write({"p.xml": including("s/0.xml"), **files, "s/14.xml": leaf})
    for link in links:
        (root / "s" / link).symlink_to(".")
    assert quickly_refused(root).code == "xml-limit"


def test_file_that_is_included_often_is_read_once(write) -> None:
    root = write({"p.xml": including(*["s/a.xml"] * 300), "s/a.xml": PROFILE})
    policy = comarmor.load(root)
    assert len(policy.profiles) == 300
    assert sorted(path.name for path in policy.seen if path.suffix) == ["a.xml", "p.xml"]


@pytest.mark.parametrize(
    ("element", "code"),
    [
        ('<xi:include href="s/a.xml" parse="text"/>', "include-parse"),
        ('<xi:include href="s/a.xml" xpointer="x"/>', "schema"),
        ('<xi:include href="s/a.xml"><xi:fallback/></xi:include>', "include-fallback"),
        ('<xi:include href="no.xml"><xi:fallback/></xi:include>', "include-fallback"),
        ("<xi:include/>", "include-href"),
        ('<xi:includ href="s/a.xml"/>', "schema"),
        ('<include href="s/a.xml"/>', "schema"),
        ('<x:include xmlns:x="http://www.w3.org/2003/XInclude" href="s/a.xml"/>', "schema"),
    ],
)
def test_only_plain_includes(write, element, code) -> None:
    assert quickly_refused(write({"p.xml": f"<profiles {XI}>{element}</profiles>", "s/a.xml": PROFILE})).code == code


def test_file_name_that_is_not_text(tmp_path) -> None:
    (tmp_path / os.fsdecode(b"p\xff.xml")).write_text("<x/>")
    with pytest.raises(ComArmorError) as caught:
        comarmor.load(tmp_path)
    str(caught.value).encode()


def test_a_document_that_is_not_a_file_includes_the_library_only(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "common").mkdir()
    (tmp_path / "common/node.xml").write_text("<profiles/>")
    profile = '<profile name="p"><attachment>/s</attachment><xi:include href="common/node.xml"/></profile>'
    found = source.read_document(f"<profiles {XI}>{profile}</profiles>".encode(), "new.xml", LIBRARY)
    (document,) = found.roots
    (included,) = document.includes.values()
    assert document.name == "new.xml"
    assert included.name == str(LIBRARY / "common/node.xml")
    for href, code in (("../x.xml", "include-outside"), ("none.xml", "include-missing")):
        with pytest.raises(ComArmorError) as caught:
            source.read_document(including(href).encode(), "new.xml", LIBRARY)
        assert caught.value.diagnostics[0].code == code
    with pytest.raises(ComArmorError, match="elements"):
        source.read_document(including("common/node.xml").encode(), "new.xml", LIBRARY, limits=Limits(nodes=2))
