# SPDX-License-Identifier: Apache-2.0
"""The structure of a policy as it is written: nesting, includes, and what is not used."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_comarmor.loaded import structure

import comarmor
from keymint.api import PolicyStructure

POLICY = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
<tunable name="UNUSED"><value>x</value></tunable>
<profile name="outer"><attachment>/r/*</attachment><attachment>/q</attachment>
<xi:include href="sub/rule.xml"/>
<profile name="inner"><attachment>*/a</attachment>
<ros_topic qualifier="DENY"><attachment>{namespace}{name}/x</attachment><attachment>/y</attachment>
<permissions><ros_publish/></permissions></ros_topic>
</profile></profile></profiles>"""
RULE = """<ros_topic qualifier="ALLOW"><attachment>/z</attachment>
<permissions><ros_subscribe/></permissions></ros_topic>"""


@pytest.fixture
def written(tmp_path: Path) -> PolicyStructure:
    (tmp_path / "sub").mkdir()
    (tmp_path / "policy.xml").write_text(POLICY)
    (tmp_path / "sub" / "rule.xml").write_text(RULE)
    return structure(comarmor.load(tmp_path))


def test_profiles_with_those_around_them(written: PolicyStructure) -> None:
    outer, inner = written.profiles
    assert (outer.name, outer.around) == ("outer", ())
    assert (inner.name, inner.around) == ("inner", (("/r/*", "/q"),))
    assert [(text, where.line) for text, where in outer.attachments] == [("/r/*", 3), ("/q", 3)]


def test_unused_tunables_with_their_place(written: PolicyStructure) -> None:
    assert [(name, where.line) for name, where in written.unused] == [("UNUSED", 2)]


def test_rules_with_their_profiles_and_expansion(written: PolicyStructure) -> None:
    by_expression = {clause.rule.expressions[0]: clause for clause in written.clauses}
    included, own = by_expression["/z"], by_expression["{namespace}{name}/x"]
    assert (included.profiles, included.included) == ((("/r/*", "/q"),), True)
    assert (own.profiles, own.included) == ((("/r/*", "/q"), ("*/a",)), False)
    assert own.expand("/r/*/", "[ab]") == ("/r/*/[ab]/x", "/y")
    assert included.expand("/r/", "a") == ("/z",)
    assert [place.line for place in own.places] == [6, 6]
