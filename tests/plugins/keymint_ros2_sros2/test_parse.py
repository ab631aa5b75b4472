# SPDX-License-Identifier: Apache-2.0
"""Both versions of policy.xml, and what is refused with its line."""

from __future__ import annotations

import pytest
from keymint_ros2_sros2.parse import parse

from comarmor.errors import ComArmorError
from comarmor.rules import Effect

from .sros2_policies import enclave, policy


def test_version_0_2_0(robot) -> None:
    found = parse(robot)
    assert found.version == "0.2.0"
    assert [each.path for each in found.enclaves] == ["/robot/talker", "/robot/listener"]
    topics, services, actions = next(found.enclaves[1].nodes()).lists
    assert topics.effects == {"ros_publish": Effect.DENY, "ros_subscribe": Effect.ALLOW}
    assert services.effects == {"ros_call": Effect.ALLOW}
    assert actions.effects == {"ros_request": Effect.ALLOW}
    assert [entry.text for entry in topics.entries] == ["/robot/*"]


def test_in_version_0_1_0_every_node_has_its_enclave(write) -> None:
    profiles = "".join(
        f'<profile ns="{ns}" node="{node}"><topics publish="ALLOW"><topic>t</topic></topics></profile>'
        for ns, node in (("/", "a"), ("/x", "b"), ("/y/", "c"), ("", "d"))
    )
    found = parse(write(f'<policy version="0.1.0"><profiles>{profiles}</profiles></policy>'))
    assert [each.path for each in found.enclaves] == ["/a", "/x/b", "/y/c", "/d"]


def test_what_has_no_meaning_is_known(write) -> None:
    text = policy(
        '<enclave path="/a"><profiles type="t"><profile ns="/" node="n"/>'
        "<metadata><anything x='1'>text</anything></metadata></profiles></enclave>"
    )
    lost = [each.message for each in parse(write(text)).lost]
    assert lost == ["the type 't' of <profiles> is not taken over", "<metadata> is not taken over"]


def test_comments_are_kept_at_their_places(write) -> None:
    text = policy(
        "<!-- one --><enclave path='/a'><!-- two --><profiles><!-- three --><profile ns='/' node='n'>"
        "<!-- four --><topics publish='ALLOW'><!-- five --><topic>t</topic><!-- six --></topics><!-- seven -->"
        "</profile></profiles></enclave><!-- eight -->"
    )
    found = parse(write("<!-- zero -->" + text))
    (only,) = found.enclaves
    (group,), (node,) = only.groups, only.nodes()
    (rules,) = node.lists
    kept = [*only.comments, *group.comments, *node.comments, *rules.comments, *rules.entries[0].comments,
            *rules.closing, *node.closing, *found.closing]  # fmt: skip
    numbers = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight"]
    assert [comment.strip() for comment in kept] == numbers


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<policy/>", "lacks its attribute 'version'"),
        ('<policy version="0.3.0"/>', "expected 0.1.0 or 0.2.0"),
        ('<policy version="0.2.0"/>', "the policy has no enclave"),
        ('<policy version="0.2.0"><profiles/></policy>', "<profiles> is not expected in a policy of version 0.2.0"),
        ('<policy version="0.1.0"><enclaves/></policy>', "<enclaves> is not expected in a policy of version 0.1.0"),
        ("<profiles/>", "<profiles> is not expected as the root, expected <policy>"),
        (policy("<enclave/>"), "lacks its attribute 'path'"),
        (policy('<enclave path="/a"/>'), "has no <profiles>"),
        (policy('<enclave path="/a"><profiles><profile ns="/"/></profiles></enclave>'), "lacks its attribute 'node'"),
        (policy(enclave("/a", '<topics publish="YES"/>')), "expected ALLOW or DENY"),
        (policy(enclave("/a", '<topics request="ALLOW"/>')), "unknown attribute 'request'"),
        (policy(enclave("/a", "")).replace("enclaves", "contexts"), "expected <enclaves> or <profiles> or <xi:*>"),
        (policy(enclave("/a", "<topics><service>x</service></topics>")), "<service> is not expected"),
        (policy(enclave("/a", "text")), "cannot contain text"),
        (policy(enclave("/a", "")).replace("<policy", "<!DOCTYPE x><policy"), "DOCTYPE"),
    ],
)
def test_refused(write, text: str, message: str) -> None:
    with pytest.raises(ComArmorError) as caught:
        parse(write(text))
    found = caught.value.diagnostics[0]
    assert message in found.message
    assert "{" not in found.message
    assert found.where is not None
    assert found.where.line == 1


@pytest.mark.parametrize(
    ("rules", "help_"),
    [
        ('<services call="ALLOW"/>', "expected request or reply"),
        ('<actions request="ALLOW"/>', "expected call or execute"),
        ('<topics call="ALLOW"/>', "expected publish or subscribe"),
        ('<services request="ALLOW" call="ALLOW"/>', "expected reply"),
        ('<topics publsh="ALLOW"/>', "did you mean 'publish'?"),
        ('<topics publish="DENY" subscribe="DENY" call="DENY"/>', "remove it"),
    ],
)
def test_only_attributes_of_the_element_are_suggested(write, rules: str, help_: str) -> None:
    """Who removes a qualifier of another list loses the right that was meant."""
    with pytest.raises(ComArmorError) as caught:
        parse(write(policy(enclave("/a", rules))))
    assert caught.value.diagnostics[0].help == help_


def test_an_included_element_in_the_wrong_place(write) -> None:
    files = {"t.xml": "<profile><topics><topic>x</topic></topics></profile>"}
    include = '<xi:include href="t.xml" xpointer="xpointer(/profile/topics)"/>'
    text = policy(f'<enclave path="/a"><profiles>{include}</profiles></enclave>')
    with pytest.raises(ComArmorError, match="<topics> is not expected in <profiles>, expected <profile>"):
        parse(write(text, files))
