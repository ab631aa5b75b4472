# SPDX-License-Identifier: Apache-2.0
"""What is written is read again, by Keymint and by Zenoh, and is the same bytes for the same data."""

from __future__ import annotations

import json
from dataclasses import replace
from types import ModuleType
from typing import Any

from hypothesis import given, strategies as st
from keymint_ros2_zenoh.documents.configuration import (
    AccessControl,
    AclPolicy,
    AclRule,
    AclSubject,
    Configuration,
    Flow,
    Message,
    Permission,
    write,
)
from keymint_ros2_zenoh.documents.configuration_reader import read

TEXT = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=8)
KEYS = st.sampled_from(["0/**", "a/*/b", "a$*/@adv/**", "@ros2_lv/0/**", "0/chatter/*/*"])


def some(values: st.SearchStrategy[Any], least: int = 1) -> st.SearchStrategy[Any]:
    return st.lists(values, min_size=least, max_size=30, unique=True).map(tuple)


@st.composite
def configurations(draw: st.DrawFn) -> Configuration:
    rules = [
        AclRule(
            name,
            draw(some(st.sampled_from(Message))),
            draw(some(st.sampled_from(Flow))),
            draw(st.sampled_from(Permission)),
            draw(some(KEYS)),
        )
        for name in draw(st.lists(TEXT, max_size=4, unique=True))
    ]
    subjects = [
        AclSubject(name, *(draw(some(TEXT, 0)) for _ in range(5)))
        for name in draw(st.lists(TEXT, max_size=4, unique=True))
    ]
    policies = []
    if rules and subjects:
        names = some(st.sampled_from([rule.id for rule in rules])), some(st.sampled_from([one.id for one in subjects]))
        policies = draw(st.lists(st.builds(AclPolicy, *names), max_size=3))
    control = AccessControl(
        draw(st.booleans()), draw(st.sampled_from(Permission)), tuple(rules), tuple(subjects), tuple(policies)
    )
    tls = *(draw(st.just("") | TEXT) for _ in range(5)), *(draw(st.booleans()) for _ in range(3))
    endpoints = some(TEXT, 0)
    return Configuration(
        draw(st.sampled_from(["router", "peer", "client"])),
        draw(endpoints),
        draw(endpoints),
        draw(st.booleans()),
        draw(st.booleans()),
        draw(endpoints),
        *tls,
        access_control=control,
        other=draw(st.sampled_from([{}, {"transport/unicast/max_links": 2, "namespace": "a b"}])),
    )


def placeless(configuration: Configuration) -> Configuration:
    control = configuration.access_control
    return replace(
        configuration,
        access_control=replace(
            control,
            where=None,
            rules=tuple(replace(rule, where=None) for rule in control.rules),
            subjects=tuple(replace(subject, where=None) for subject in control.subjects),
            policies=tuple(replace(policy, where=None) for policy in control.policies),
        ),
    )


@given(configurations())
def test_what_is_written_is_read_again(configuration: Configuration) -> None:
    content = write(configuration, ["What it is", "", "and for whom"])
    assert content.startswith(b"// What it is\n//\n// and for whom\n{\n")
    assert placeless(read(content, "f")) == configuration
    assert write(configuration, []) == write(placeless(read(content, "f")), [])


def test_zenoh_reads_what_is_written(zenoh: ModuleType) -> None:
    control = AccessControl(
        True,
        Permission.DENY,
        (AclRule("/ü 1", (Message.PUT,), (Flow.INGRESS,), Permission.ALLOW, tuple(f"0/{n}/*/*" for n in range(99))),),
        (AclSubject("/ü", ("/ü\u2028\U0001f600\"'\\",)),),
        (AclPolicy(("/ü 1",), ("/ü",)),),
    )
    configuration = Configuration(
        "client", ("tls/localhost:7447",), (), False, False, ("tls",), "/ca.pem", mutual=True, access_control=control,
        other={"transport/unicast/max_links": 1},
    )  # fmt: skip
    content = write(configuration, ["title"])
    assert max(map(len, content.decode().splitlines())) <= 120
    config = zenoh.Config.from_json5(content.decode())
    theirs = json.loads(config.get_json("access_control"))
    assert theirs["rules"][0]["key_exprs"] == [f"0/{n}/*/*" for n in range(99)]
    assert theirs["subjects"][0]["cert_common_names"] == ["/ü\u2028\U0001f600\"'\\"]
    assert json.loads(config.get_json("mode")) == "client"
    assert json.loads(config.get_json("listen/endpoints")) == []
    assert json.loads(config.get_json("connect/endpoints")) == ["tls/localhost:7447"]
    assert json.loads(config.get_json("transport/link/tls/enable_mtls")) is True
    assert json.loads(config.get_json("transport/unicast/max_links")) == 1
