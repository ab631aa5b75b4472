# SPDX-License-Identifier: Apache-2.0
"""Configurations are read as Zenoh reads them, and what it refuses at start is refused."""

from __future__ import annotations

import json
from types import ModuleType
from typing import Any

import pytest
from keymint_ros2_zenoh.documents.configuration import (
    AccessControl,
    AclPolicy,
    AclRule,
    AclSubject,
    Configuration,
    Flow,
    Message,
    Permission,
)
from keymint_ros2_zenoh.documents.configuration_reader import read

from comarmor.errors import Origin
from keymint.errors import KeymintError

RULE = {"id": "r", "messages": ["put"], "flows": ["ingress"], "permission": "allow", "key_exprs": ["a/**"]}
SUBJECT = {"id": "s", "cert_common_names": ["/a"]}
POLICY = {"rules": ["r"], "subjects": ["s"]}
CONTROL: dict[str, Any] = {
    "enabled": True,
    "default_permission": "deny",
    "rules": [RULE],
    "subjects": [SUBJECT],
    "policies": [POLICY],
}


def reading(**settings: Any) -> Configuration:
    return read(json.dumps(settings).encode(), "r.json5")


def control(**changed: Any) -> AccessControl:
    return reading(access_control={**CONTROL, **changed}).access_control


def refused(text: str) -> tuple[str, str]:
    with pytest.raises(KeymintError) as caught:
        read(text.encode(), "r.json5")
    diagnostic = caught.value.diagnostics[0]
    return f"{diagnostic.code} {diagnostic.message}", str(diagnostic.where)


def test_an_empty_file_has_the_defaults_of_a_peer() -> None:
    assert reading() == Configuration("peer", (), ("tcp/[::]:0",), True, True)
    assert reading().access_control == AccessControl(enabled=False, default_permission=Permission.DENY)


@pytest.mark.parametrize(
    ("mode", "listen"), [("client", ()), ("peer", ("tcp/[::]:0",)), ("router", ("tcp/[::]:7447",)), (None, None)]
)
def test_the_default_of_listen_depends_on_the_mode(mode: str | None, listen: tuple[str, ...] | None) -> None:
    assert reading(mode=mode).listen == (("tcp/[::]:0",) if listen is None else listen)
    assert reading(mode=mode, listen={"endpoints": []}).listen == ()


def test_settings_that_depend_on_the_mode() -> None:
    settings: dict[str, Any] = {
        "connect": {"endpoints": {"client": ["tls/a:1"], "peer": ["tcp/b:2"]}},
        "scouting": {"gossip": {"enabled": {"client": False}}, "multicast": {"enabled": False}},
    }
    client, peer = reading(mode="client", **settings), reading(mode="peer", **settings)
    assert (client.connect, client.gossip, client.multicast) == (("tls/a:1",), False, False)
    assert (peer.connect, peer.gossip, peer.multicast) == (("tcp/b:2",), True, False)


def test_certificates_and_keys() -> None:
    tls = {
        "root_ca_certificate": "/ca",
        "listen_certificate": "/lc",
        "listen_private_key": "/lk",
        "connect_certificate": "/cc",
        "connect_private_key": "/ck",
        "enable_mtls": True,
        "verify_name_on_connect": False,
        "close_link_on_expiration": True,
    }
    link = {"protocols": ["tls"], "tls": tls}
    configuration = reading(transport={"link": link})
    assert configuration == Configuration(
        "peer", (), ("tcp/[::]:0",), True, True, ("tls",), "/ca", "/lc", "/lk", "/cc", "/ck", mutual=True,
        verify_name=False, close_expired=True,
    )  # fmt: skip
    assert reading(transport={"link": {"tls": {"enable_mtls": None}}}) == reading()


def test_other_settings_are_kept_with_their_places() -> None:
    text = b"{\n  mode: 'client',\n  transport: {\n    unicast: {max_links: 2, x: null},\n  },\n  namespace: 'a',\n}"
    configuration = read(text, "r.json5")
    assert configuration.other == {"transport/unicast/max_links": 2, "transport/unicast/x": None, "namespace": "a"}
    assert configuration.place("transport/unicast/max_links") == Origin("r.json5", 4)
    assert configuration.place("transport/link/tls") == Origin("r.json5", 3)
    assert configuration.place("scouting/gossip") == Origin("r.json5")


def test_objects_without_members_are_kept_where_their_name_may_say_something() -> None:
    assert reading(scouting={"gossip": {}}, transport={}).other == {}
    assert reading(plugins={"rest": {}}, adminspace={}).other == {"plugins/rest": {}, "adminspace": {}}


def test_a_key_that_looks_like_a_path_is_no_setting() -> None:
    configuration = reading(**{"connect/endpoints": ["tls/a:1"]})
    assert configuration.connect == ()
    assert list(configuration.other) == ["'connect/endpoints'"]


def test_access_control() -> None:
    subject = {
        "id": "t",
        "usernames": ["u"],
        "interfaces": ["lo"],
        "link_protocols": ["tls"],
        "zids": ["1"],
        "cert_common_names": None,
    }
    rule = {"id": "q", "messages": ["query", "reply"], "permission": "deny", "key_exprs": ["b", "c/*"]}
    text = json.dumps({"access_control": {**CONTROL, "rules": [RULE, rule], "subjects": [SUBJECT, subject]}}, indent=1)
    read_control = read(text.encode(), "r.json5").access_control
    assert read_control.enabled
    assert read_control.default_permission is Permission.DENY
    first, second = read_control.rules
    assert first == AclRule("r", (Message.PUT,), (Flow.INGRESS,), Permission.ALLOW, ("a/**",), Origin("r.json5", 6))
    assert second.flows == (Flow.EGRESS, Flow.INGRESS)
    assert second.messages == (Message.QUERY, Message.REPLY)
    assert read_control.subjects[0] == AclSubject("s", ("/a",), where=read_control.subjects[0].where)
    assert read_control.subjects[1] == AclSubject(
        "t", (), ("u",), ("lo",), ("tls",), ("1",), read_control.subjects[1].where
    )
    assert read_control.policies == (AclPolicy(("r",), ("s",), read_control.policies[0].where),)
    assert read_control.where == Origin("r.json5", 2)


def test_all_defects_of_ids_and_key_expressions_are_reported_together() -> None:
    broken = {
        **CONTROL,
        "rules": [RULE, RULE, {**RULE, "id": "q", "key_exprs": ["/a", "b*"]}],
        "policies": [{"rules": ["rr"], "subjects": ["z"]}],
    }
    with pytest.raises(KeymintError) as caught:
        reading(access_control=broken)
    messages = [diagnostic.message for diagnostic in caught.value.diagnostics]
    assert len(messages) == 5
    assert messages[0] == "the rule 'r' occurs twice"
    assert messages[1] == "there is no rule 'rr'"


def test_a_violation_of_the_schema_has_its_line() -> None:
    rules = '[\n {id: "r", messages: ["put"],\n  flows: ["ingres"],\n  permission: "allow", key_exprs: ["a"]}]'
    message, where = refused("{access_control: {enabled: true, rules: " + rules + "}}")
    assert where == "r.json5:3"
    assert "access_control/rules/0/flows/0" in message
    assert "must be one of" in message


def _without(member: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in member.items() if name != key}


REFUSALS = [
    *({"rules": [_without(RULE, key)]} for key in ("id", "messages", "permission", "key_exprs")),
    *({"rules": [{**RULE, key: []}]} for key in ("messages", "flows", "key_exprs")),
    *({key: None} for key in ("rules", "subjects", "policies", "enabled", "default_permission")),
    {"rules": [{**RULE, "id": ""}], "policies": [{**POLICY, "rules": [""]}]},
    {"rules": [{**RULE, "messages": ["publish"]}]},
    {"rules": [{**RULE, "flows": ["in"]}]},
    {"rules": [{**RULE, "permission": "Allow"}]},
    {"rules": [{**RULE, "key_exprs": ["/a"]}]},
    {"rules": [{**RULE, "key_exprs": ["a*"]}]},
    {"rules": [{**RULE, "key_exprs": ["**/**"]}]},
    {"rules": [{**RULE, "key_exprs": ["a/$*"]}]},
    {"rules": [{**RULE, "flow": ["ingress"]}]},
    {"rules": [RULE, RULE]},
    {"subjects": [SUBJECT, SUBJECT]},
    {"subjects": [{**SUBJECT, "cert_common_names": []}]},
    {"subjects": [{**SUBJECT, "cert_common_names": [""]}]},
    {"subjects": [{**SUBJECT, "common_names": ["a"]}]},
    {"subjects": [{"cert_common_names": ["a"]}]},
    {"policies": [{**POLICY, "rules": ["q"]}]},
    {"policies": [{**POLICY, "subjects": ["q"]}]},
    {"policies": [{**POLICY, "rules": []}]},
    {"policies": [{**POLICY, "subjects": []}]},
    {"policies": [{**POLICY, "id": "p"}, {**POLICY, "id": "p"}]},
    {"policies": [{**POLICY, "ids": "p"}]},
    {"enabled": "true"},
    {"default_permission": "Deny"},
    {"acl": 1},
]
ACCEPTED: list[dict[str, Any]] = [
    {},
    {"rules": [], "subjects": [], "policies": []},
    {"enabled": False},
    {"rules": [{**RULE, "flows": None}]},
    {"rules": [RULE, {**RULE, "id": "q"}]},
    {"rules": [{**RULE, "messages": ["put", "put"]}]},
    {"rules": [{**RULE, "key_exprs": ["@ros2_lv/**", "a$*/*/**", "**/@adv/**"]}]},
    {"policies": [POLICY, POLICY]},
    {"policies": [{**POLICY, "id": None}]},
    {"subjects": [{"id": "s"}]},
    {"subjects": [{**SUBJECT, "zids": None}]},
]


def _starts(zenoh: ModuleType, changed: dict[str, Any]) -> bool:
    """Tell whether a real router accepts an access control."""
    quiet = {"mode": "router", "listen": {"endpoints": []}, "scouting": {"multicast": {"enabled": False}}}
    try:
        config = zenoh.Config.from_json5(json.dumps({**quiet, "access_control": {**CONTROL, **changed}}))
        zenoh.open(config).close()
    except zenoh.ZError:
        return False
    return True


@pytest.mark.parametrize("changed", REFUSALS, ids=json.dumps)
def test_what_zenoh_refuses_is_refused(zenoh: ModuleType, changed: dict[str, Any]) -> None:
    with pytest.raises(KeymintError):
        control(**changed)
    assert not _starts(zenoh, changed)


@pytest.mark.parametrize("changed", ACCEPTED, ids=json.dumps)
def test_what_is_accepted_zenoh_accepts(zenoh: ModuleType, changed: dict[str, Any]) -> None:
    control(**changed)
    assert _starts(zenoh, changed)


@pytest.mark.parametrize("missing", ["rules", "subjects", "policies"])
def test_all_three_lists_are_needed(zenoh: ModuleType, missing: str) -> None:
    with pytest.raises(KeymintError, match=f"has no {missing}"):
        reading(access_control=_without(CONTROL, missing))
    with pytest.raises(zenoh.ZError):
        zenoh.open(zenoh.Config.from_json5(json.dumps({"access_control": _without(CONTROL, missing)})))


def test_the_defaults_are_those_of_zenoh(zenoh: ModuleType) -> None:
    """A session may have other defaults than a configuration shows, so only what it shows is compared."""
    theirs = json.loads(str(zenoh.Config()))
    assert theirs["listen"]["endpoints"] == {"peer": ["tcp/[::]:0"], "router": ["tcp/[::]:7447"]}
    assert theirs["connect"]["endpoints"] == []
    assert theirs["access_control"]["enabled"] is False
    assert theirs["access_control"]["default_permission"] == "deny"


@pytest.mark.parametrize("kind", ["mode", "scouting", "transport", "listen"])
def test_settings_of_a_wrong_type(zenoh: ModuleType, kind: str) -> None:
    with pytest.raises(KeymintError):
        reading(**{kind: 7})
    with pytest.raises(zenoh.ZError):
        zenoh.Config.from_json5(json.dumps({kind: 7}))
