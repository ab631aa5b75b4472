# SPDX-License-Identifier: Apache-2.0
"""A policy with profiles that are written alike is the same as if each of them was parsed."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from comarmor.errors import ComArmorError
from comarmor.language import alike_profiles
from comarmor.language.loading import load
from comarmor.language.parse import parse
from comarmor.language.policy import Policy
from comarmor.language.source import load_tree
from tests.effort import tries

NODE = """<ros_topic qualifier="ALLOW"><attachment>{namespace}x</attachment><attachment>/rosout</attachment>
<permissions><ros_publish/></permissions></ros_topic>"""
OTHER = '<profiles><profile name="other"><attachment>/other</attachment></profile></profiles>'
FORMS = (
    """
  <profile name="p%n">
    <attachment>/r%n</attachment>
    <xi:include href="node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>/d/%d</attachment>
      <attachment>/d/%d*</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
  </profile>""",
    """
  <profile name="p%n" modifier="AUDIT">
    <attachments><attachment>/r%n</attachment></attachments>
    <topic qualifier="DENY">
      <attachment>/d/%d</attachment>
      <permissions><publish/></permissions>
      <partitions><partition>a%n</partition></partitions>
    </topic>
  </profile>""",
    """
  <profile name="p%n"><attachment>/r%n</attachment>
    <ros_service qualifier="ALLOW"><attachment>/{name}%d</attachment><attachment>/s%d</attachment>
      <permissions><ros_call/></permissions></ros_service></profile>""",
    """
  <profile name="p%n">
    <attachment>/r%n</attachment>
    <attachment>/q%d</attachment>
    <ros_service qualifier="ALLOW">
      <attachment>{name}/%d</attachment>
      <attachment>/s%d
      </attachment>
      <attachment>/t%d</attachment>
      <permissions><ros_call/></permissions>
    </ros_service></profile>""",
)
OUTER = '\n<profile name="out"><attachment>/r1</attachment>'
TUNABLE = '<tunable name="X"><value>/a</value></tunable>'
RULE = '<ros_topic qualifier="DENY"><attachment>/q</attachment><permissions><ros_publish/></permissions></ros_topic>'
BLANK = ("\n", " ", "\t", "\r\n", "<!-- c -->", '<!-- <profile name="x"> -->', "<!-- </profile> -->", "<?p q?>")
INCLUDES = ('<xi:include href="node.xml"/>', '<xi:include href="other.xml"/>')
HARMLESS = (*BLANK, *INCLUDES, "é", "*", "a", "/b", "_", TUNABLE, RULE)
TAGS = ('<profile name="x">', "</profile>", "<profile modifier='AUDIT' name='y'>", "<profiles>", '<profile name="e"/>')
INNER = ('<tunable name="X"><value>', "</value></tunable>", "<attachments>", "</attachments>")
MARKS = ("<!--", "-->", "<![CDATA[", "]]>", "&amp;", '"', "\r", "\x0b")
TEXTS = ("@{X}", "**", "{name}", "?", "[a]", "\\", "<attachment>/a</attachment>")
PIECES = (*TAGS, *INNER, *MARKS, *TEXTS)


def around(profiles: str, form: int = 0) -> str:
    top = profile(1, 7)  # so that only white space is above the others
    last = profile(form, 8) + profile(form, 9)  # with fewer than three the file is read as a whole
    return f'<profiles xmlns:xi="http://www.w3.org/2001/XInclude">{top}{profiles}{last}\n</profiles>\n'


def profile(form: int, number: int, name: str = "a") -> str:
    return FORMS[form].replace("%n", str(number)).replace("%d", name)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "parts").mkdir()
    (tmp_path / "node.xml").write_text(NODE)
    (tmp_path / "other.xml").write_text(OTHER)
    return tmp_path / "policy.xml"


def meaning(load_it: Callable[[], Policy]) -> object:
    """Return all that a policy is, with the places of its parts, or its defects."""
    try:
        policy = load_it()
    except ComArmorError as error:
        return error.diagnostics
    return policy.profiles, policy.seen, policy.unused_tunables, policy.subjects()


def assert_same(file: Path, content: str) -> None:
    """Check that the short form does not change the policy, or its defects."""
    file.write_bytes(content.encode())
    assert meaning(lambda: load(file)) == meaning(lambda: parse(load_tree(file)))


@pytest.mark.parametrize("form", range(len(FORMS)))
def test_profiles_that_are_alike_are_parsed_once(file: Path, form: int, monkeypatch: pytest.MonkeyPatch) -> None:
    out = f"\n<!-- {profile(form, 99)} -->"
    content = around(out + "".join(profile(form, number, "bc"[number % 2]) for number in range(6)))
    assert_same(file, content)
    made: list[object] = []
    monkeypatch.setattr(alike_profiles, "_copied", lambda profile, copy: made.append(copy) or profile)
    load(file)
    # The texts that differ must be the last ones in their lines; partitions are part of the form; two more are last.
    assert len(made) == {0: 6, 1: 1, 2: 1, 3: 4}[form]


def test_what_only_looks_like_a_profile_stays_without_effect(file: Path) -> None:
    first, second = profile(0, 1), profile(0, 2)
    for content in (
        around(f"{first}<!--{second}-->"),
        around(f"{first}<!--{second}{profile(0, 3)}-->"),
        around(f"<!--{first}-->{second}"),
        around(f"{first}<!--{profile(3, 3)}{second}-->"),
        around(f"<!--{profile(3, 3)}{first}-->{profile(3, 4)}{second}"),
        around(f"{first}<!-- </profile> -->{second}"),
        around(first.replace("<attachment>", "<!-- </profile> --><attachment>", 1) + second),
        around(first.replace("<xi:", f"<!-- </profile>{second} --><xi:", 1) + profile(0, 3)),
        around(profile(0, 0) + first.replace("<xi:", f"<!-- </profile>{second} --><xi:", 1), 3),
        around(f'{first}<tunable name="X"><value>{second}</value></tunable>'),
        around(f"{first}<![CDATA[{second}]]>"),
        around(f"{first}<?p {second}?>"),
        around(f'{first}\n<profile name="out"><attachment>/r1</attachment>{second}{profile(0, 3)}</profile>'),
        around(
            f'{first}\n<profile name="out"><attachment>/x</attachment>{second}{profile(0, 3)}</profile>{profile(0, 4)}'
        ),
        around(f"{first}\x0b{second}"),
        around(f"{first}\r {second}"),
    ):
        assert_same(file, content)


def test_each_copy_is_judged(file: Path) -> None:
    illegal = profile(0, 2).replace("/r2", "r2")
    assert_same(file, around(profile(0, 1) + illegal))
    with pytest.raises(ComArmorError) as caught:
        load(file)
    assert caught.value.diagnostics[0].where.line == 20
    assert_same(file, around(profile(0, 1, "x*y") + profile(0, 2, "x**y") + profile(0, 3, "-.")))
    # Texts that are the same in the first profile, and differ in the second.
    assert_same(file, around(profile(0, 1).replace("/d/a*", "/d/a") + profile(0, 2)))


def test_any_change_of_the_text_means_the_same(file: Path) -> None:
    rng = random.Random(27)
    for _ in range(tries(200, 5_000)):
        forms = rng.sample(range(len(FORMS)), rng.choice((1, 1, 2, 3)))
        content = around("".join(profile(rng.choice(forms), n, rng.choice("ab")) for n in range(rng.choice((3, 6)))))
        for _ in range(rng.choice((0, 1, 1, 2, 3))):
            borders = [at for at, char in enumerate(content) if char in "<\n"] + [content.rindex(">")]
            at, other = sorted(rng.choice(borders) for _ in range(2))
            match rng.randrange(8):
                case 0:
                    content = content[:at] + content[at + rng.randrange(30) :]
                case 1:
                    content = content[:at] + content[at:other][:300] + content[at:]
                case 2:
                    content = f"{content[:at]}<!--{content[at:other]}-->{content[other:]}"
                case 3 | 4:
                    content = content[:at] + rng.choice(PIECES) + content[at:]
                case _:
                    content = content[:at] + rng.choice(HARMLESS) + content[at:]
        assert_same(file, content)
