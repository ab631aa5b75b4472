# SPDX-License-Identifier: Apache-2.0
"""``keymint learn --from-keystore``: a policy from signed documents, or an error with a place and nothing written."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

import comarmor
from tests import sros2_keystore
from tests.sros2_keystore import Form

POLICY = """<policy version="0.2.0"><enclaves>
  <enclave path="/robot/talker"><profiles><profile ns="/robot" node="talker">
    <topics publish="ALLOW" subscribe="DENY"><topic>chatter</topic><topic>~/p*</topic></topics>
    <actions call="ALLOW"><action>/dock</action></actions>
  </profile></profiles></enclave>
  <enclave path="/listener"><profiles><profile ns="/" node="listener">
    <topics subscribe="ALLOW"><topic>/robot/*</topic></topics>
    <topics subscribe="DENY"><topic>/robot/secret</topic></topics>
    <services reply="ALLOW"><service>add</service></services>
  </profile></profiles></enclave>
</enclaves></policy>"""
OLD = """<policy version="0.1.0"><profiles><profile ns="/robot" node="talker">
  <topics publish="ALLOW"><topic>chatter</topic></topics></profile></profiles></policy>"""


@pytest.fixture
def keystore(tmp_path: Path) -> Callable[..., Path]:
    """Make a keystore of SROS2, and its policy beside it."""

    def made(policy: str = POLICY, form: Form | None = None) -> Path:
        (tmp_path / "sros2.xml").write_text(policy)
        sros2_keystore.make(tmp_path / "ks", policy, form)
        return tmp_path / "ks"

    return made


def errors(outcome, tmp_path: Path) -> list[tuple[str, str]]:
    """Return codes and places of errors; nothing was written."""
    assert outcome.code == 1
    assert not (tmp_path / "p.xml").exists()
    found = json.loads(outcome.out)["diagnostics"]
    return [(each["code"], f"{each['file']}:{each['line'] or 0}") for each in found if each["severity"] == "error"]


@pytest.mark.parametrize(
    ("policy", "form", "options"),
    [
        (POLICY, Form(), []),
        (POLICY, Form(two=True, zone=True, graph=False), ["--no-implicit"]),
        (POLICY, Form(layout="rti"), []),
        (OLD, Form(layout="flat"), ["--no-implicit"]),
    ],
    ids=["sros2", "two", "rti", "flat"],
)
def test_it_means_what_the_policy_of_the_keystore_means(
    keymint, keystore, tmp_path: Path, policy: str, form: Form, options: list[str]
) -> None:
    keystore(policy, form)
    outcome = keymint("learn", "--from-keystore", "ks", "-o", "p.xml")
    assert outcome.code == 0
    assert "proven to allow, for all names, what the signed documents permit" in outcome.out
    assert keymint("import", "sros2.xml", "-o", "imported", *options).code == 0
    assert keymint("diff", "imported", "p.xml").code == 0  # another engine: over subjects and names
    learned = comarmor.load(tmp_path / "p.xml")
    assert set(learned.subjects()) == set(sros2_keystore.enclaves_of(policy))
    assert {rule.kind for rule in learned.rules("/robot/talker")} <= {"ros_topic", "ros_action", "topic"}


def test_names_come_back_as_those_of_ros(keymint, keystore, tmp_path: Path) -> None:
    keystore()
    outcome = keymint("learn", "--from-keystore", "ks")
    assert outcome.err == ""
    (tmp_path / "p.xml").write_text(outcome.out)
    rules = {
        (str(rule.effect), permission, expression)
        for rule in comarmor.load(tmp_path / "p.xml").rules("/robot/talker")
        for permission in rule.permissions
        for expression in rule.expressions
    }
    assert rules == {
        ("ALLOW", "ros_publish", "/robot/chatter"), ("ALLOW", "ros_publish", "/robot/talker/p*"),
        ("DENY", "ros_subscribe", "/robot/chatter"), ("DENY", "ros_subscribe", "/robot/talker/p*"),
        ("ALLOW", "ros_request", "/dock"),
        ("ALLOW", "publish", "ros_discovery_info"), ("ALLOW", "subscribe", "ros_discovery_info"),
    }  # fmt: skip


def test_a_domain_is_a_warning_and_part_of_the_result(keymint, keystore) -> None:
    keystore(form=Form(domain=5))
    outcome = keymint("learn", "--from-keystore", "ks", "-o", "p.xml", "--json")
    report = json.loads(outcome.out)
    assert report["result"]["domains"] == [5]
    assert report["result"]["written"] == ["p.xml"]
    (warning,) = [each for each in report["diagnostics"] if each["code"] == "learn-domain"]
    assert "domain 5" in warning["message"]
    assert warning["help"] == "keymint provision p.xml --domain 5"


def test_documents_for_different_domains(keymint, keystore, tmp_path: Path) -> None:
    root = keystore()
    other = OLD.replace("talker", "other")
    sros2_keystore.make(tmp_path / "second", other, Form(layout="flat", domain=3))
    place = root / "enclaves/robot/other"
    place.mkdir()
    for name in ("cert.pem", "key.pem", "permissions.p7s", "governance.p7s"):
        (place / name).write_bytes((tmp_path / "second/robot/other" / name).read_bytes())
    for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
        (place / name).write_bytes((tmp_path / "second/ca.cert.pem").read_bytes())
    # Another authority: whose word counts is for the owner to decide.
    assert {code for code, _ in errors(keymint("learn", "--from-keystore", "ks", "--json"), tmp_path)} == {
        "adopt-authorities"
    }


def resign(root: Path, enclave: str, change: Callable[[str], str]) -> None:
    """Change the document of an enclave, and sign it again with the authority of the keystore."""
    place = root / "enclaves" / enclave
    (place / "permissions.xml").write_text(change((place / "permissions.xml").read_text()))
    key, certificate = root / "private/ca.key.pem", root / "public/ca.cert.pem"
    subprocess.run(
        ["openssl", "smime", "-sign", "-text", "-in", place / "permissions.xml", "-signer", certificate,
         "-inkey", key, "-out", place / "permissions.p7s"],
        check=True, capture_output=True,
    )  # fmt: skip


def test_what_is_not_signed_is_not_learned(keymint, keystore, tmp_path: Path) -> None:
    root = keystore()
    signed = root / "enclaves/listener/permissions.p7s"
    signed.write_bytes(signed.read_bytes().replace(b"rt/robot/*", b"rt/r*"))
    found = errors(keymint("learn", "--from-keystore", "ks", "-o", "p.xml", "--json"), tmp_path)
    assert found == [("smime-altered", "ks/enclaves/listener/permissions.p7s:0")]


def test_files_that_are_missing_or_lie_elsewhere(keymint, keystore, tmp_path: Path) -> None:
    root = keystore()
    (tmp_path / "elsewhere.p7s").write_bytes((root / "enclaves/listener/permissions.p7s").read_bytes())
    (root / "enclaves/listener/permissions.p7s").unlink()
    (root / "enclaves/listener/permissions.p7s").symlink_to("../../../elsewhere.p7s")
    (root / "enclaves/robot/talker/cert.pem").unlink()
    found = errors(keymint("learn", "--from-keystore", "ks", "-o", "p.xml", "--json"), tmp_path)
    assert [code for code, _ in found] == ["file-missing", "file-missing"]


def test_what_no_policy_can_say_is_an_error_at_its_line(keymint, keystore, tmp_path: Path) -> None:
    root = keystore()
    resign(root, "listener", lambda text: re.sub(r"(<allow_rule>\s*<domains>\s*<id>)0", r"\g<1>4", text, count=1))
    found = errors(keymint("learn", "--from-keystore", "ks", "-o", "p.xml", "--json"), tmp_path)
    line = next(
        number
        for number, text in enumerate((root / "enclaves/listener/permissions.p7s").read_text().splitlines(), 1)
        if "<deny_rule>" in text
    )
    assert found == [("learn-unsayable", f"ks/enclaves/listener/permissions.p7s:{line}")]


def test_a_path_that_no_policy_can_name(keymint, keystore, tmp_path: Path) -> None:
    keystore(POLICY.replace('"/listener"', '"/a b"'))
    found = errors(keymint("learn", "--from-keystore", "ks", "-o", "p.xml", "--json"), tmp_path)
    assert found == [("name-illegal", "ks/enclaves/a b:0")]


def test_grants_without_effect_are_warnings(keymint, keystore, tmp_path: Path) -> None:
    twice = POLICY.replace(
        "</profiles></enclave>\n</enclaves>",
        """</profiles><profiles><profile ns="/" node="n">
        <topics publish="ALLOW"><topic>other</topic></topics></profile></profiles></enclave></enclaves>""",
    )
    keystore(twice)
    outcome = keymint("learn", "--from-keystore", "ks", "-o", "p.xml")
    assert outcome.code == 0
    assert "this grant of 'CN=/listener' is never in force, and is not learned" in outcome.err
    rules = comarmor.load(tmp_path / "p.xml").rules("/listener")
    assert not any("/other" in rule.expressions for rule in rules)


def test_files_are_replaced_only_by_force(keymint, keystore, tmp_path: Path) -> None:
    keystore()
    learn = ("learn", "--from-keystore", "ks", "-o", "p.xml")
    assert "p.xml would be written" in keymint(*learn, "--dry-run").out
    assert not (tmp_path / "p.xml").exists()
    assert keymint(*learn).code == 0
    assert "p.xml is up to date" in keymint(*learn).out
    (tmp_path / "p.xml").write_text("mine")
    assert "exists and differs" in keymint(*learn).err
    assert (tmp_path / "p.xml").read_text() == "mine"
    assert keymint(*learn, "--force").code == 0
    assert (tmp_path / "p.xml").read_text() != "mine"


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("learn",), "the argument GRAPH is missing"),
        (("learn", "g.json", "--from-keystore", "ks"), "takes neither a graph nor --policy"),
        (("learn", "--from-keystore", "ks", "--policy", "p.xml"), "takes neither a graph nor --policy"),
    ],
)
def test_usage(keymint, arguments: tuple[str, ...], reason: str) -> None:
    outcome = keymint(*arguments)
    assert outcome.code == 2
    assert reason in outcome.err


def test_a_folder_that_is_no_keystore(keymint, tmp_path: Path) -> None:
    assert "no such folder" in keymint("learn", "--from-keystore", "nowhere").err
    (tmp_path / "empty").mkdir()
    assert "has no enclave" in keymint("learn", "--from-keystore", "empty").err
    (tmp_path / "file").write_text("")
    assert "is not a folder" in keymint("learn", "--from-keystore", "file").err
