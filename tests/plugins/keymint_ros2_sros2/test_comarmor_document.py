# SPDX-License-Identifier: Apache-2.0
"""The written policy: a profile for each enclave, its comments, and what the library has in place of included rules."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_sros2.parse import parse
from keymint_ros2_sros2.translate import comarmor_document

import comarmor
from comarmor.data import locate

from .sros2_policies import COMMON, INCLUDE, enclave, policy

LIBRARY = locate("keymint_ros", "templates") / "comarmor.d" / "foxy"


def written(path: Path, *, implicit: bool = True) -> str:
    found = parse(path)
    enclaves, graph = [[each] for each in found.enclaves], implicit and found.has_graph
    text = comarmor_document(enclaves, found.closing, LIBRARY, graph=graph).decode()
    new(path).parent.mkdir(exist_ok=True)
    new(path).write_text(text)
    comarmor.load(new(path), library=LIBRARY)  # it is a policy
    return text


def new(path: Path) -> Path:
    """The new policy, away from SROS2's folder of common files."""
    return path.parent / "comarmor.d" / "new.xml"


def test_the_common_files_of_the_node_itself_become_one_include(write) -> None:
    text = written(write(policy(enclave("/talker", INCLUDE, "/", "talker"), enclave("/other", "")), COMMON))
    assert text.count("xi:include href") == 2
    assert '<xi:include href="common/node.xml" parse="xml"/>' in text
    assert '<xi:include href="common/node/graph.xml" parse="xml"/>' in text  # of the other, which includes nothing
    assert text.count("/talker/get_parameters<") == 1
    assert "ros_call" in text  # SROS2 also lets it call its own services
    assert "ros_execute" not in text


def test_where_the_node_is_not_named_like_the_enclave_its_parts_do(robot: Path) -> None:
    talker = written(robot).partition("</profile>")[0]
    for name in ("graph", "parameter_events", "parameters", "time"):
        assert f'href="common/node/{name}.xml"' in talker
    assert "<attachment>/robot/rosout<" in talker


def test_what_a_person_wrote_stays_as_it_is(write) -> None:
    own = '<topics subscribe="ALLOW"><topic>/clock</topic></topics>'
    text = written(write(policy(enclave("/n", own))), implicit=False)
    assert "include" not in text
    assert "xmlns" not in text
    assert "<attachment>/clock</attachment>" in text


def test_rules_that_several_nodes_include_are_written_once(write) -> None:
    nodes = "".join(f'<profile ns="/" node="{name}">{INCLUDE}</profile>' for name in "ab")
    text = written(write(policy(f'<enclave path="/both"><profiles>{nodes}</profiles></enclave>'), COMMON))
    assert text.count("/a/get_parameters<") == text.count("/b/get_parameters<") == 1
    assert text.count("parameter_events") == 1


def test_comments_and_nodes(write) -> None:
    rules = (
        '<!-- about the list --><topics publish="ALLOW"><topic>a</topic><!-- about b --><topic>b</topic></topics>'
        "<!-- end of the node -->"
    )
    text = written(write(policy("<!-- about the enclave -->" + enclave("/e", rules, "/ns", "n") + "<!-- the end -->")))
    order = [
        "about the enclave", "the node n in the namespace /ns", "about the list", "/ns/a<", "about b", "/ns/b<",
        "end of the node", "the end",
    ]  # fmt: skip
    places = [text.index(each) for each in order]
    assert places == sorted(places)


def test_a_comment_before_an_include_stays_and_those_of_what_the_library_has_do_not(write) -> None:
    common = COMMON | {"common/node.xml": COMMON["common/node.xml"].replace("<xi:", "<!-- of SROS2 --><xi:")}
    more = {"own.xml": '<profile><topics publish="ALLOW"><!-- inner --><topic>/x</topic></topics></profile>'}
    include = INCLUDE.replace("common/node", "own")
    text = written(write(policy(enclave("/n", f"<!-- for all --> {INCLUDE}<!-- ours -->{include}")), common | more))
    assert "of SROS2" not in text
    assert text.index("the node n") < text.index("for all") < text.index("ours") < text.index("inner")


@pytest.mark.parametrize(
    ("ns", "node", "said"),
    [
        ("/a--b", "n-", "n- in the namespace /a- -b "),
        ("/-", "a---b", "a- - -b in the namespace /- "),
        ("/", "--", "- - in"),
    ],
)
def test_a_name_that_no_comment_can_hold(write, ns: str, node: str, said: str) -> None:
    text = written(write(policy(enclave("/e", "", ns, node))))
    assert f"<!-- the node {said}" in text


@pytest.mark.parametrize("name", ["/a{b}", "/@{X}", "/a b", "/[ab]*?", "/{name}"])
def test_names_keep_their_meaning(write, name: str) -> None:
    path = write(policy(enclave("/e", f'<topics publish="ALLOW"><topic>{name}</topic></topics>')))
    written(path)
    loaded = comarmor.load(new(path), library=LIBRARY)
    example = name.replace("[ab]*?", "b12")
    assert loaded.decide("/e", "ros_topic", "ros_publish", example).allowed
    assert not loaded.decide("/e", "ros_topic", "ros_publish", "/e").allowed


def test_qualifiers_of_one_list_that_differ(write) -> None:
    rules = '<services request="ALLOW" reply="DENY"><service>s</service></services>'
    text = written(write(policy(enclave("/e", rules))), implicit=False)
    assert text.count("<ros_service") == 2
    assert text.index('qualifier="ALLOW"') < text.index("ros_call")
    assert text.index('qualifier="DENY"') < text.index("ros_execute")
