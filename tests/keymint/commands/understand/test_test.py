# SPDX-License-Identifier: Apache-2.0
"""``keymint test``."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from tests.conftest import CHECKOUT

POLICY = """<profiles><profile name="a"><attachment>/a</attachment>
<ros_topic qualifier="ALLOW"><attachment>/x/*</attachment><permissions><ros_publish/></permissions></ros_topic>
<ros_topic qualifier="DENY"><attachment>/x/secret</attachment><permissions><ros_publish/></permissions></ros_topic>
</profile><profile name="g"><attachment>/guest/*</attachment>
<ros_service qualifier="ALLOW"><attachment>{namespace}say</attachment>
<permissions><ros_call/></permissions></ros_service>
</profile></profiles>"""


@pytest.fixture
def expect(keymint, tmp_path: Path):
    """Run the tests of a policy with these expectations."""
    (tmp_path / "p.xml").write_text(POLICY)

    def run(*expectations: str, options: tuple[object, ...] = ()):
        (tmp_path / "p.test.xml").write_text('<tests><test name="t">\n' + "\n".join(expectations) + "</test></tests>")
        return keymint("test", "p.xml", *options)

    return run


def one(element: str, subject: str, permission: str, name: str) -> str:
    return f'<{element} subject="{subject}" permission="{permission}" object="{name}"/>'


@pytest.mark.parametrize(
    ("element", "subject", "permission", "name", "said"),
    [
        ("allow", "/a", "publish", "/x/y", ""),
        ("allow", "/a", "ros_publish", "/x/y/*", ""),
        ("allow", "/a", "publish", "/x/secret", "/a may not ros_publish /x/secret: a DENY rule matches"),
        ("allow", "/a", "publish", "/x/*", "/a may not ros_publish /x/secret: a DENY rule matches"),
        ("allow", "/a", "publish", "/y", "/a may not ros_publish /y: no rule allows it"),
        ("allow", "/b*", "publish", "/x/y", "the policy names no subject that matches it"),
        ("deny", "/a", "publish", "/x/secret", ""),
        ("deny", "/a", "publish", "/x/s*", "/a may ros_publish /x/s"),
        ("deny", "/guest/*", "call", "/safety/*", ""),
        ("deny", "/guest/*", "call", "/guest/say", "/guest/x may ros_call /guest/say"),
        ("deny", "*", "publish", "/y", ""),
        ("deny", "/*", "publish", "/x/y", "/a may ros_publish /x/y"),
    ],
)
def test_an_expectation(expect, element: str, subject: str, permission: str, name: str, said: str) -> None:
    outcome = expect(one(element, subject, permission, name))
    assert outcome.code == (3 if said else 0), outcome.err
    assert said in outcome.err
    assert ("p.test.xml:2: error: t: expected" in outcome.err) is bool(said)


def test_coverage(expect) -> None:
    outcome = expect(one("allow", "/a", "publish", "/x/y"), options=("-v",))
    assert outcome.out == "1 of 1 expectations hold; 1 of 3 rules are exercised (33 %)\n"
    assert "p.xml:3: note: no expectation covers this DENY ros_topic rule (ros_publish)" in outcome.err
    assert expect(one("allow", "/a", "publish", "/x/y"), options=("--min-coverage", "50")).code == 3
    close = expect(one("allow", "/a", "publish", "/x/y"), options=("--min-coverage", "33.4"))
    assert "rule coverage is 33.3 %, below 33.4 %" in close.err
    outcome = expect(
        one("allow", "/a", "publish", "/x/y"),
        one("deny", "/a", "publish", "/x/secret"),
        options=("--min-coverage", "60"),
    )
    assert outcome.code == 0, outcome.err


def test_junit(expect, tmp_path: Path) -> None:
    expect(one("allow", "/a", "publish", "/x/y"), one("deny", "/a", "publish", "/x/y"), options=("--junit", "out.xml"))
    suite = ET.fromstring((tmp_path / "out.xml").read_bytes())[0]
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("p.test.xml", "1", "1")
    assert suite[0][0].text == "p.test.xml:3: /a may ros_publish /x/y"


@pytest.mark.parametrize(
    ("expectation", "said"),
    [
        (
            one("deny", "/a", "publsh", "/x"),
            "p.test.xml:2: error: there is no permission 'publsh' (did you mean 'publish'?)",
        ),
        (one("deny", "/a", "ros_publish", "x"), "ROS names begin with '/'"),
        (one("deny", "/a", "ros_publish", "//x"), "no legal object name matches '//x'"),
        ("<alow/>", "p.test.xml:2"),
    ],
)
def test_mistakes(expect, expectation: str, said: str) -> None:
    outcome = expect(expectation)
    assert outcome.code != 0
    assert outcome.out == ""
    assert said in outcome.err


def test_a_subject_that_nothing_applies_to_is_in_doubt(expect) -> None:
    outcome = expect(one("deny", "/aa", "publish", "/x"))
    assert outcome.code == 0
    assert "no profile of the policy applies to /aa, so it has no permissions; did you mean '/a'?" in outcome.err


def test_no_tests(keymint, policy: Path) -> None:
    outcome = keymint("test", policy.name)
    assert (outcome.code, outcome.out) == (1, "")
    assert "write policy.test.xml" in outcome.err


def test_the_workspace(keymint, provisioned: Path, tmp_path: Path) -> None:
    text = '<tests><test name="t"><allow subject="/talker" permission="publish" object="/chatter"/></test></tests>'
    (tmp_path / "policy.test.xml").write_text(text)
    assert keymint("test", cwd=provisioned).out == ("1 of 1 expectations hold; 1 of 2 rules are exercised (50 %)\n")


def test_the_fleet(keymint) -> None:
    result = keymint("test", CHECKOUT / "examples/fleet", "--min-coverage", "100", "--json").document["result"]
    assert (result["failed"], result["exercised"]) == (0, result["rules"])


@pytest.mark.parametrize(
    ("subject", "said"),
    [
        ("9x", "no legal subject name matches '9x'"),
        ("/9*", "no legal subject name matches '/9*'"),
    ],
)
def test_a_subject_that_cannot_be(expect, subject: str, said: str) -> None:
    outcome = expect(one("deny", subject, "publish", "/x"))
    assert outcome.code == 1
    assert said in outcome.err


def test_a_policy_that_does_not_exist(keymint) -> None:
    outcome = keymint("test", "nothing.xml")
    assert outcome.code == 1
    assert "the policy 'nothing.xml' does not exist" in outcome.err
