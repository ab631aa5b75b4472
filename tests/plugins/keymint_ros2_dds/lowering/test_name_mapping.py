# SPDX-License-Identifier: Apache-2.0
"""ROS names as DDS topics: the image of an expression is exact."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.lowering.name_mapping import (
    DDS_TOPICS,
    DISTROS,
    DdsTopic,
    check_distro,
    dds_patterns,
)

from comarmor.patterns.expression import exact
from comarmor.patterns.glob import parse
from keymint.errors import KeymintError

TOPIC = DDS_TOPICS["ros_publish"][0]


def images_of(expression, topic=TOPIC, part=""):
    """Return the topic patterns of an expression since Bouncy, which uses no partitions."""
    pairs = list(dds_patterns("bouncy", parse(expression), topic, part))
    assert all(partition is None for _, partition in pairs)
    return tuple(pattern for pattern, _ in pairs)


@pytest.mark.parametrize(
    ("expression", "images"),
    [
        ("/chatter", {"rt/chatter"}),
        ("*/scan", {"rt/scan", "rt/*/scan"}),
        ("*", {"rt/*"}),
        ("?x", {"rt/x"}),
        ("[!a]b", {"rt/b"}),
        ("/a*", {"rt/a*"}),
        ("**/a", {"rt/a", "rt/*/a"}),
        ("chatter", set()),
        ("[ab]x", set()),
        ("", set()),
    ],
)
def test_the_image_of_a_topic(expression, images):
    assert {exact(pattern) for pattern in images_of(expression)} == images


def test_a_service_is_two_topics():
    client, server = DDS_TOPICS["ros_call"], DDS_TOPICS["ros_execute"]
    assert client == (DdsTopic("publish", "rq", "Request"), DdsTopic("subscribe", "rr", "Reply"))
    assert {(one.prefix, one.suffix) for one in client} == {(one.prefix, one.suffix) for one in server}
    assert {one.action for one in client if one.prefix == "rq"} != {one.action for one in server if one.prefix == "rq"}
    assert images_of("/add", client[0]) == (("rq/addRequest",),)


def test_a_part_of_a_composite_follows_the_name():
    assert images_of("/fib", part="/_action/status") == (("rt/fib/_action/status",),)
    assert {exact(pattern) for pattern in images_of("*", part="/_action/status")} == {
        "rt/*/_action/status",
        "rt/_action/status",
    }


def test_a_raw_topic_is_its_own_name():
    assert images_of("sensor*", DDS_TOPICS["publish"][0]) == (parse("sensor*"),)


@pytest.mark.parametrize("distro", DISTROS)
def test_distros_are_known(distro):
    check_distro(distro)


@pytest.mark.parametrize(("distro", "message"), [("ardnt", "did you mean 'ardent'"), ("jazy", "did you mean 'jazzy'")])
def test_other_distros_are_refused(distro, message):
    with pytest.raises(KeymintError, match=message):
        check_distro(distro)
