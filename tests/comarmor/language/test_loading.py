# SPDX-License-Identifier: Apache-2.0
"""Policies are loaded from files, folders and libraries."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest

import comarmor
from comarmor.language.policy_files import PolicyFile

from .policies import allow, include, profile, topics

REFERENCE = Path(__file__).parents[4] / "shared" / "reference" / "ppac" / "comarmor.d"


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
    assert {path.name for path in policy.seen if path.is_file()} == {"a.xml", "b.xml", "c.xml"}
    assert all(len(digest) == 32 for path, digest in policy.seen.items() if path.is_file())
    assert comarmor.load(root / "a.xml").subjects() == ("/a",)


def test_union_of_policies(write) -> None:
    root = write({"a/x.xml": profile(attachment="/a"), "b/y.xml": profile(attachment="/b")})
    policy = comarmor.load(root / "a", root / "b" / "y.xml")
    assert policy.subjects() == ("/a", "/b")
    assert {path.name for path in policy.seen if path.is_file()} == {"x.xml", "y.xml"}


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


def test_nothing_to_load(tmp_path) -> None:
    for path, code in ((tmp_path, "policy-empty"), (tmp_path / "x", "policy-missing"), (Path("\0"), "policy-missing")):
        with pytest.raises(comarmor.ComArmorError) as caught:
            comarmor.load(path)
        assert caught.value.diagnostics[0].code == code


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference material is not here")
def test_policy_of_the_field() -> None:
    policy = comarmor.load(REFERENCE)
    assert policy.subjects() == ("/listener", "/talker")
    assert policy.decide("/talker", "ros_topic", "ros_publish", "/chatter").allowed
    assert not policy.decide("/talker", "ros_topic", "ros_subscribe", "/chatter").allowed
    assert policy.decide("/listener", "ros_service", "ros_call", "/listener/get_parameters").allowed


def test_defects_of_all_policies_are_reported_once_each(write) -> None:
    root = write({"a/x.xml": profile(allow("{x}")), "b/y.xml": profile(allow("{y}")), "c/z.xml": profile()})
    with pytest.raises(comarmor.ComArmorError) as caught:
        comarmor.load(root / "a", root / "b", root / "a", root / "c")
    assert [diagnostic.where.file for diagnostic in caught.value.diagnostics if diagnostic.where] == [
        f"{root}/a/x.xml",
        f"{root}/b/y.xml",
    ]


def test_origins_name_the_library_as_it_is_shown(write, tmp_path) -> None:
    root = write({"p.xml": profile(include("node.xml"))})
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "node.xml").write_text(allow("/x"))
    policy = comarmor.load(root, library=tmp_path / "cache", library_shown=Path("lib"))
    assert str(policy.rules("/s")[0].origin) == f"lib/node.xml:1, included from {root}/p.xml:1"


def test_a_loaded_policy_keeps_no_document(write) -> None:
    root = write({"a.xml": profile(include("sub/b.xml")), "sub/b.xml": allow("/b")})
    gc.collect()
    gc.disable()
    try:
        policy = comarmor.load(root)
        kept = [each for each in gc.get_objects() if isinstance(each, PolicyFile)]
    finally:
        gc.enable()
    assert topics(policy) == ["/b"]
    assert not kept
