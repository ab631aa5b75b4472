# SPDX-License-Identifier: Apache-2.0
"""What the rows of tables mean."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from keymint_comarmor.loaded import ComArmorPolicy
from keymint_ros2_comarmor import policy_type as comarmor_type
from keymint_ros2_table.policy import load

from comarmor.data import locate
from comarmor.errors import Origin
from keymint.api import PolicySource
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_table.tables import csv_file

LIBRARY = locate("keymint_ros", "templates") / "comarmor.d/iron"


def loaded(*paths: Path) -> ComArmorPolicy:
    return load([PolicySource("t", path, Origin("policies.xml", 1)) for path in paths], LIBRARY)


def messages(folder: Path, *rows: str) -> list[str]:
    with pytest.raises(KeymintError) as error:
        loaded(csv_file(folder, *rows))
    return [str(each).replace(f"{folder}/", "") for each in error.value.diagnostics]


def test_it_is_the_policy_in_xml_with_the_same_rules(tmp_path: Path) -> None:
    rows = csv_file(
        tmp_path,
        "*,include,,common/node.xml,,,",
        "/a/n,ros_topic,ros_publish,{namespace}x,ALLOW,1,",
        "/a/*,ros_topic,ros_publish,/secret*,DENY,,",
        "/b,topic,subscribe,rt/y,ALLOW,,",
    )
    document = tmp_path / "policy.xml"
    document.write_text(
        '<profiles xmlns:xi="http://www.w3.org/2001/XInclude">'
        '<profile name="all"><attachment>*</attachment><xi:include href="common/node.xml"/></profile>'
        '<profile name="n"><attachment>/a/n</attachment><ros_topic qualifier="ALLOW" modifier="AUDIT"><attachment>'
        "{namespace}x</attachment><permissions><ros_publish/></permissions></ros_topic></profile>"
        '<profile name="a"><attachment>/a/*</attachment><ros_topic qualifier="DENY"><attachment>/secret*</attachment>'
        "<permissions><ros_publish/></permissions></ros_topic></profile>"
        '<profile name="b"><attachment>/b</attachment><topic qualifier="ALLOW"><attachment>rt/y</attachment>'
        "<permissions><subscribe/></permissions></topic></profile></profiles>"
    )
    table, written = loaded(rows), comarmor_type.load([PolicySource("t", document, Origin("p"))], LIBRARY)
    assert table.subjects() == written.subjects() == ("/a/n", "/b")
    for subject in ("/a/n", "/b", "/a/other", "/c"):
        ours, theirs = ((each.rules(subject)) for each in (table, written))
        assert ours
        assert theirs
        nowhere = Origin("-")
        assert [replace(rule, origin=nowhere) for rule in ours.rules] == [
            replace(rule, origin=nowhere) for rule in theirs.rules
        ]


def test_places_of_rules_and_of_those_that_are_included(tmp_path: Path) -> None:
    path = csv_file(tmp_path, "/a,include,,common/node/time.xml,,,fleet", "/a,ros_topic,ros_publish,/x,ALLOW,,ticket 1")
    rules = loaded(path).rules("/a")
    assert rules
    included, own = rules.rules
    assert str(included.origin).endswith("common/node/time.xml:3 (library), included from fleet [rules.csv]:2")
    assert str(own.origin) == "ticket 1 [rules.csv]:3"
    assert LIBRARY / "common/node/time.xml" in loaded(path).seen


def test_all_defects_are_told_each_with_its_row_and_source(tmp_path: Path) -> None:
    said = messages(
        tmp_path,
        "/a,ros_topc,ros_publish,/x,ALLOW,,s",
        "/a,ros_topic,publish,/x,ALLOW,,",
        "/a,ros_topic,,/x,ALLOW,,",
        "/a,ros_topic,ros_publish,/x,allow,,",
        "/a,ros_topic,ros_publish,/x,ALLOW,maybe,",
        "/a,ros_topic,ros_publish,,ALLOW,,",
        "/a,ros_topic,ros_publish,/{nme},ALLOW,,",
        "/a,ros_topic,ros_publish,@{T},ALLOW,,",
        "/1a,ros_topic,ros_publish,/x,ALLOW,,",
        "{name},ros_topic,ros_publish,/x,ALLOW,,",
        ",ros_topic,ros_publish,/x,ALLOW,,",
        "/a,include,,common/nde.xml,,,s",
        "/a,include,,../node.xml,,,",
        "/a,include,ros_publish,common/node.xml,ALLOW,,",
    )
    starts = (
        "s [rules.csv]:2: 'ros_topc' is no kind (did you mean 'ros_topic'?)",
        "rules.csv:3: 'publish' is no permission of ros_topic (did you mean 'ros_publish'?)",
        "rules.csv:4: the permission of ros_topic is missing (expected ros_publish, ros_subscribe, ros_relay)",
        "rules.csv:5: 'allow' is no qualifier (did you mean 'ALLOW'?)",
        "rules.csv:6: 'maybe' is no value of audit",
        "rules.csv:7: the object is empty (for any name write *)",
        "rules.csv:8: '{nme}' is unknown",
        "rules.csv:9: the object cannot contain a tunable: '@{T}'",
        "rules.csv:10: '/1a' is not a legal name of a subject",
        "rules.csv:11: the subject cannot contain {name} or {namespace}",
        "rules.csv:12: the subject is empty",
        "s [rules.csv]:13: the included file 'common/nde.xml' does not exist",
        "rules.csv:14: '../node.xml' is outside",
        "rules.csv:15: a row that includes a file has no permission, qualifier or audit",
    )
    assert len(said) == len(starts)
    assert [each for each, start in zip(said, starts, strict=True) if not each.startswith(start)] == []


def test_a_character_that_nobody_sees_is_refused(tmp_path: Path) -> None:
    (said,) = messages(tmp_path, "/a,ros_topic,ros_publish,/x\u200b,ALLOW,,")
    assert said.startswith("rules.csv:2: the object has characters that cannot be printed")


def test_many_defects_end(tmp_path: Path) -> None:
    assert len(messages(tmp_path, *["/a,b,c,/x,ALLOW,,"] * 500)) == 101


def test_several_tables_are_one_policy(tmp_path: Path) -> None:
    first = csv_file(tmp_path, "/a,ros_topic,ros_publish,/x,ALLOW,,").rename(tmp_path / "a.csv")
    second = csv_file(tmp_path, "/b,ros_topic,ros_publish,/x,ALLOW,,")
    assert loaded(first, second).subjects() == ("/a", "/b")


def test_a_table_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(KeymintError) as error:
        loaded(tmp_path / "gone.csv")
    (found,) = error.value.diagnostics
    assert (found.code, found.where) == ("policy-missing", Origin("policies.xml", 1))
