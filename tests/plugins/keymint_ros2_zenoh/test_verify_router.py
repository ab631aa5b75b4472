# SPDX-License-Identifier: Apache-2.0
"""A router file that decides otherwise is a mismatch of ``verify``, which also asks about the names in the file."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

POLICY = """<profiles>
  <profile name="t"><attachment>/talker</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/log/*</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="DENY"><attachment>/log/private*</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="l"><attachment>/listener</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_subscribe/></permissions></ros_topic>
    <ros_service qualifier="ALLOW"><attachment>/add</attachment><permissions><ros_execute/></permissions></ros_service>
  </profile>
</profiles>
"""  # noqa: E501
Control = dict[str, Any]
ALL = ["put", "delete", "declare_subscriber", "query", "reply", "declare_queryable", "liveliness_token"]
ALL += ["liveliness_query", "declare_liveliness_subscriber"]


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("zenoh")


@pytest.fixture
def workspace(keymint: Callable, once: Path, tmp_path: Path) -> Path:
    if not (once / "ws").exists():
        (once / "policy.xml").write_text(POLICY)
        made = keymint("provision", "policy.xml", "-w", "ws", "--transport", "zenoh", "--no-prove", cwd=once)
        assert made.code == 0, made.err
    shutil.copytree(once, tmp_path, dirs_exist_ok=True)
    return tmp_path / "ws"


def altered(workspace: Path, change: Callable[[Control], None]) -> None:
    """Change the router file as an attacker would, not through the data types of the compiler."""
    file = workspace / "install/zenoh/router.json5"
    document = json.loads(re.sub(r"^//.*$", "", file.read_text(), flags=re.MULTILINE))
    change(document)
    file.write_text(json.dumps(document, indent=1))


def wrong(keymint: Callable, workspace: Path) -> list[Any]:
    """Return the requests on which the model differs from the policy."""
    outcome = keymint("verify", "-w", workspace, "-i", "zenoh-1", "--json")
    [result] = outcome.document["result"]["transports"]
    return list(result["findings"])


def added(*keys: str, subject: str = "/talker", effect: str = "allow") -> Callable[[Control], None]:
    """Return an alteration that gives a subject a rule about all messages."""

    def change(document: Control) -> None:
        control = document["access_control"]
        rule = {"id": "x", "permission": effect, "flows": ["ingress", "egress"], "messages": ALL, "key_exprs": keys}
        control["rules"].append(rule)
        control["policies"].append({"subjects": [subject], "rules": ["x"]})

    return change


def of_rules(subject: str, change: Callable[[Control], None]) -> Callable[[Control], None]:
    """Return an alteration of all rules of a subject."""

    def of_all(document: Control) -> None:
        for rule in document["access_control"]["rules"]:
            if rule["id"].startswith(subject):
                change(rule)

    return of_all


def with_control(change: Callable[[Control], object]) -> Callable[[Control], None]:
    return lambda document: change(document["access_control"]) and None


def shared_rules(control: Control) -> None:
    """Give each subject the rules of both."""
    for policy in control["policies"]:
        policy["subjects"] = ["/listener", "/talker"]


def without(*ids: str) -> Callable[[Control], None]:
    def change(control: Control) -> None:
        control["rules"] = [each for each in control["rules"] if each["id"] not in ids]
        for policy in control["policies"]:
            policy["rules"] = [each for each in policy["rules"] if each not in ids]

    return change


def swapped(control: Control) -> None:
    one, other = control["subjects"]
    one["cert_common_names"], other["cert_common_names"] = other["cert_common_names"], one["cert_common_names"]


ALTERATIONS: dict[str, Callable[[Control], None]] = {
    "a name": added("0/zz/*/*", "0/zz/*/*/@adv/**"),
    "a name of two chunks": added("0/zz/top/*/*", "0/zz/top/*/*/@adv/**"),
    "a name for the other": added("0/zz/*/*", "0/zz/*/*/@adv/**", subject="/listener"),
    "names that begin alike": added("0/zz$*/*/*", "0/zz$*/*/*/@adv/**"),
    "names that end alike": added("0/**/zz/*/*", "0/**/zz/*/*/@adv/**"),
    "names with a chunk between": added("0/zz/*/end/*/*", "0/zz/*/end/*/*/@adv/**"),
    "names below": added("0/zz/*/*/**", "0/zz/*/*/**/@adv/**"),
    "infix": added("0/$*zz$*/*/*", "0/$*zz$*/*/*/@adv/**"),
    "everything": added("**"),
    "everything in the domain": added("0/**"),
    "any domain": added("*/zz/*/*", "*/zz/*/*/@adv/**"),
    "the rights of the other": added("0/add/*/*", "0/add/*/*/@adv/**"),
    "a denial of what is allowed": added("0/chatter/*/*", effect="deny"),
    "a denial below what is allowed": added("0/log/zz/*/*", effect="deny"),
    "a denial of everything": added("**", effect="deny"),
    "default": with_control(lambda control: control.update(default_permission="allow")),
    "off": with_control(lambda control: control.update(enabled=False)),
    "rights exchanged": with_control(swapped),
    "rights shared": with_control(shared_rules),
    "denial removed": with_control(without("/talker 5")),
    "rules removed": with_control(without("/talker 1", "/talker 2")),
    "denial allows": with_control(lambda control: control["rules"][13].update(permission="allow")),
    "more flows": of_rules("/listener", lambda rule: rule.update(flows=["ingress", "egress"])),
    "more messages": of_rules("/listener", lambda rule: rule.update(messages=ALL, flows=["ingress", "egress"])),
    "fewer messages": of_rules("/talker", lambda rule: rule.update(messages=["put"])),
    "a listed interface": with_control(lambda control: control["subjects"][1].update(interfaces=["eth9"])),
    "for everyone": with_control(lambda control: control["subjects"][1].pop("cert_common_names")),
    "no certificates of sessions": lambda document: document["transport"]["link"]["tls"].update(enable_mtls=False),
    "another listener": lambda document: document["listen"].update(endpoints=["tls/localhost:7448"]),
}


@pytest.mark.parametrize("alteration", ALTERATIONS)
def test_an_alteration_that_decides_otherwise_is_found(keymint: Callable, workspace: Path, alteration: str) -> None:
    altered(workspace, ALTERATIONS[alteration])
    assert wrong(keymint, workspace)


def test_what_changes_no_decision_is_no_mismatch(keymint: Callable, workspace: Path) -> None:
    assert not wrong(keymint, workspace)
    altered(workspace, with_control(lambda control: control["rules"].reverse()))
    assert not wrong(keymint, workspace)


def test_a_file_that_cannot_be_read_is_no_source_of_questions(keymint: Callable, workspace: Path) -> None:
    (workspace / "install/zenoh/router.json5").write_text("{")
    outcome = keymint("verify", "-w", workspace, "-i", "zenoh-1")
    assert outcome.code in (1, 3)
    assert "router.json5" in outcome.err
