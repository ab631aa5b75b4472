# SPDX-License-Identifier: Apache-2.0
"""Likely mistakes in attachments, and names that no ROS object can have."""

from __future__ import annotations

from pathlib import Path

import pytest

from comarmor.patterns.decision_lists import Equal
from comarmor.patterns.glob import parse
from comarmor.patterns.possible_names import advice, matches_ros_name
from keymint.analysis.attachment_mistakes import attachment_mistakes
from keymint.analysis.rule_lists import allow_only, find_permitted
from tests.generated import tokens
from tests.keymint.analysis.policies import deny, loaded_text, rule

PUB = ("ros_topic", "ros_publish")
SCAN = rule(*PUB, "/scan")
ODOM = rule(*PUB, "/odom")


def named(name: str, attachment: str, *inside: str) -> str:
    attached = "".join(f"<attachment>{each}</attachment>" for each in attachment.split())
    return f'<profile name="{name}">{attached}\n{"".join(inside)}</profile>\n'


def found(folder: Path, *profiles: str, **files: str) -> list[tuple[str, int]]:
    for name, text in files.items():
        (folder / f"{name}.xml").write_text(text)
    xi = 'xmlns:xi="http://www.w3.org/2001/XInclude"'
    written = loaded_text(folder, f"<profiles {xi}>\n" + "".join(profiles) + "</profiles>").structure()
    assert written is not None
    said = list(attachment_mistakes(written))
    assert all(each.help and each.where for each in said)
    return [(each.code, each.where.line) for each in said if each.where]


@pytest.mark.parametrize(
    ("profiles", "expected"),
    [
        ([named("a", "/x", SCAN), named("a", "/y", ODOM)], [("profile-name-twice", 5)]),
        ([named("a", "/x", SCAN), named("a", "/x", SCAN)], [("profile-name-twice", 5)]),
        ([named("a", "/x", SCAN), named("b", "/x", ODOM)], [("profile-copied", 5)]),
        ([named("a", "/x /y", SCAN), named("b", "/y /x", ODOM)], [("profile-copied", 5)]),
        ([named("r", "/r/*", named("a", "/r/x", SCAN), named("b", "/r/x", ODOM))], [("profile-copied", 6)]),
        ([named("cam", "/rover/*", SCAN), named("base", "/rover/base", ODOM)], [("profile-wide", 2)]),
        ([named("base", "/rover/base", ODOM), named("cam", "/rover/ca* /rover/b*", SCAN)], [("profile-wide", 5)]),
        (
            [named("cam", "/rover/*", SCAN), *(named(f"n{at}", f"/rover/n{at}") for at in range(50))],
            [("profile-wide", 2)],
        ),
        # What the documentation shows.
        ([named("a", "/x", named("i", "/x", SCAN)), named("b", "/y", named("i", "/y", SCAN))], []),
        ([named("nodes", "/x /y", ODOM), named("a", "/x", SCAN), named("b", "/y", SCAN)], []),
        ([named("all", "*", SCAN), named("base", "/rover/base", ODOM)], []),
        ([named("all", "/*", SCAN), named("base", "/rover/base", ODOM)], []),
        ([named("talkers", "*/talker", SCAN), named("base", "/rover/talker", ODOM)], []),
        ([named("robot", "/rover/*", SCAN, named("base", "/rover/base", ODOM))], []),
        ([named("cam", "/rover/*", deny(*PUB, "/x")), named("base", "/rover/base", ODOM)], []),
        ([named("cam", "/rover/*", ODOM), named("base", "/rover/base", ODOM)], []),
        ([named("robot", "/rover/*", rule(*PUB, "{namespace}tf")), named("base", "/rover/base", ODOM)], []),
        ([named("cam", "/rover/*", SCAN), named("base", "/other/base", ODOM)], []),
    ],
)
def test_profiles(tmp_path: Path, profiles: list[str], expected: list[tuple[str, int]]) -> None:
    assert found(tmp_path, *profiles) == expected


def test_what_is_included_is_meant_for_several(tmp_path: Path) -> None:
    include = '<xi:include href="sub.xml" parse="xml"/>'
    assert found(tmp_path, named("r", "/r/*", include), named("b", "/r/b"), sub=SCAN) == []
    twice = f"<profiles>{named('s', '/s', SCAN)}</profiles>"
    assert found(tmp_path, include, include, named("amendment", "/s", ODOM), sub=twice) == []


def test_build_and_provision_warn_once(keymint, tmp_path: Path) -> None:
    nodes = "".join(named(f"n{at}", f"/rover/n{at}", rule(*PUB, f"/t{at}")) for at in range(3))
    text = f"<profiles>{named('cam', '/rover/*', SCAN)}{nodes}{named('n0', '/rover/z', ODOM)}</profiles>"
    (tmp_path / "policy").mkdir()
    (tmp_path / "policy" / "p.xml").write_text(text)
    made = keymint("provision", "policy", "-w", "ws", "--json")
    assert made.code == 0
    wanted = ["profile-name-twice", "profile-wide"]
    assert sorted(each for each in made.codes() if each.startswith("profile")) == wanted
    keymint("init", "other", "--policy", "policy")
    keymint("create", "--all", cwd=tmp_path / "other")
    built = keymint("build", "--json", cwd=tmp_path / "other")
    assert sorted(each for each in built.codes() if each.startswith("profile")) == wanted
    assert keymint("lint", "policy").code == 3
    assert "profile" not in "".join(keymint("provision", "policy", "-w", "ws", "--json").codes())


@pytest.mark.parametrize(
    ("expression", "told"),
    [
        ("~/scan", "{namespace}{name}/scan"),
        ("/~/scan", "{namespace}{name}/scan"),
        ("rt/x", "write '/x'"),
        ("rq/svcRequest", "kind 'topic'"),
        ("/rover/(scan|odom)", "<attachment> for each"),
        ("/rover/scan.raw", "segments are"),
        ("/rover/.*", "write '/rover/*'"),
        ("/rover/my-scan", "write '/rover/my_scan'"),
        ("scan", "write '/scan'"),
        ("/a//b", "write '/a/b'"),
        ("/a/", "write '/a'"),
        ("/1st", "begin with a digit"),
    ],
)
def test_names_that_no_object_can_have(keymint, tmp_path: Path, expression: str, told: str) -> None:
    assert not matches_ros_name(parse(expression))
    assert told in advice(expression)
    text = f"<profiles>{named('p', '/s', SCAN, rule(*PUB, expression))}</profiles>"
    (tmp_path / "p.xml").write_text(text)
    said = keymint("lint", "p.xml", "--json").document["diagnostics"]
    (lint,) = (each for each in said if each["code"] == "object-never")
    assert told in lint["help"]


def test_build_warns_of_them_with_their_place(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(
        f"<profiles>\n{named('p', '/s', SCAN, rule(*PUB, '/rover/(scan|odom)'))}</profiles>"
    )
    said = keymint("provision", "p.xml", "-w", "ws", "--json").document["diagnostics"]
    (never,) = (each for each in said if each["code"] == "never-matches")
    assert (never["file"], never["line"], never["severity"]) == ("p.xml", 4, "warning")
    assert "<attachment> for each" in never["help"]


def test_the_quick_decision_agrees_with_the_proof_engine() -> None:
    texts = {
        token.removeprefix("<attachment>").removesuffix("</attachment>")
        for seed in range(30)
        for token in tokens(seed)
        if token.startswith("<attachment>") and "{" not in token
    }
    texts |= {
        "",
        "*",
        "/",
        "?",
        "/?",
        "//*",
        "/*/",
        "[0-9]*",
        "/[0-9]*",
        "/[0-9a]",
        "/a[!a-z]",
        "/a[.-]",
        "*//*",
        "/a/?[/]b",
        "a*/",
    }
    for text in texts:
        pattern = parse(text)
        proven = isinstance(find_permitted("ros_topic", allow_only(pattern)), Equal)
        assert matches_ros_name(pattern) is not proven, text
