# SPDX-License-Identifier: Apache-2.0
"""``keymint prove``: proven, refuted, unknown; and what the record saves."""

from __future__ import annotations

import itertools
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from keymint.pki import certificates, keys, smime
from keymint.stages import proof_results


def resign(workspace: Path, name: str, old: str, new: str) -> None:
    """Replace a text of an installed document, and sign it again."""
    folder = workspace / "install/enclaves" / name
    content = (folder / "permissions.xml").read_text()
    assert old in content
    certificate = certificates.load((workspace / "public/permissions_ca.cert.pem").read_bytes())
    key = keys.from_pem((workspace / "private/permissions_ca.key.pem").read_bytes(), None)
    (folder / "permissions.p7s").write_bytes(smime.sign(content.replace(old, new).encode(), certificate, key))


def test_what_was_provisioned_is_proven(keymint: Callable, provisioned: Path):
    outcome = keymint("prove", "-w", provisioned)
    assert outcome.code == 0
    assert "18 of 18 claims proven" in outcome.out
    assert " for omg, cyclonedds-0.10 (measured), fastdds-2.11 (from sources): " in outcome.out
    document = keymint("prove", "-w", provisioned, "--json").document
    across = {"cyclonedds-11", "fastdds-2.9", "fastdds-3.3"}
    assert set(document["result"]["assumptions"]) == {"omg", "cyclonedds-0.10", "fastdds-2.11"} | across
    assert document["result"]["models"] == {
        "omg": "specified", "cyclonedds-0.10": "measured", "cyclonedds-11": "from sources", "fastdds-2.9": "measured",
        "fastdds-2.11": "from sources", "fastdds-3.3": "measured",
    }  # fmt: skip
    assert [one["proof"] for one in document["result"]["enclaves"]] == ["proven", "proven"]


def test_a_counterexample_names_the_rule_the_line_and_both_names(keymint: Callable, provisioned: Path):
    resign(provisioned, "talker", "<topic>rt/chatter</topic>", "")
    outcome = keymint("prove", "-w", provisioned, "talker", "--json")
    assert outcome.code == 3
    assert "counterexample" in outcome.codes()
    (enclave,) = outcome.document["result"]["enclaves"]
    assert enclave["proof"] == "counterexample"
    found = [claim["counterexample"] for claim in enclave["claims"] if claim["proof"] == "counterexample"]
    assert len(found) == 3
    for one in found:
        assert one["name"] == "rt/chatter"
        assert one["ros"] == {"kind": "ros_topic", "permission": "ros_publish", "name": "/chatter"}
        assert one["policy"]["allowed"] is True
        assert (one["policy"]["file"], one["policy"]["line"]) == ("policy.xml", 5)
        assert one["document"]["allowed"] is False
        assert one["document"]["line"] > 0
    said = keymint("prove", "-w", provisioned, "talker").err
    assert "policy.xml:5: error: /talker: the document does not permit it to publish 'rt/chatter'" in said
    assert said.count("error:") == 1, "findings that all models share are reported once"


@pytest.mark.parametrize("option", ["--states=1", "--seconds=0"])
def test_what_is_not_decided_is_unknown_and_a_finding(keymint: Callable, provisioned: Path, policy: Path, option: str):
    policy.write_text(policy.read_text().replace("/chatter", "/chat*"))
    outcome = keymint("prove", "-w", provisioned, option, "--json")
    assert outcome.code == 3
    assert "not-proven" in outcome.codes()


def test_a_dry_run_records_nothing(keymint: Callable, provisioned: Path):
    before = (provisioned / ".keymint/state.json").read_bytes()
    assert keymint("prove", "-w", provisioned, "--dry-run").code == 0
    assert (provisioned / ".keymint/state.json").read_bytes() == before


def test_install_refuses_what_is_not_proven(keymint: Callable, provisioned: Path):
    document = provisioned / "build/talker/permissions.xml"
    document.write_text(document.read_text().replace("rt/chatter", "rt/chatter*"))
    installed = provisioned / "install/enclaves/talker/permissions.p7s"
    before = installed.read_bytes()
    outcome = keymint("install", "-w", provisioned)
    assert outcome.code == 3
    assert "permits it to publish 'rt/chattera'" in outcome.err
    assert installed.read_bytes() == before, "nothing is installed"
    assert "build/talker/permissions.xml: error: a manual edit changes" in outcome.err, "the cause is reported as well"
    assert "--allow-vendor-specific" not in outcome.err, "the standard is at odds with it as well"
    assert keymint("install", "--no-prove", "-w", provisioned).code == 0
    assert installed.read_bytes() != before, "unless that is asked for"


def test_a_refutation_says_each_place_once_and_as_the_user_types_it(keymint: Callable, provisioned: Path):
    resign(provisioned, "talker", "<topic>rt/chatter</topic>", "")
    said = keymint("prove", "-w", provisioned, "talker").err
    assert said.count("policy.xml") == 1
    assert said.startswith(
        "policy.xml:5: error: /talker: the document does not permit it to publish 'rt/chatter' (the ROS"
    )
    assert str(provisioned) not in said


def test_models_that_decide_alike_for_other_reasons_are_told_apart(keymint: Callable, provisioned: Path):
    document = (provisioned / "install/enclaves/talker/permissions.xml").read_text()
    subject = document.partition("<subject_name>")[2].partition("</")[0]
    resign(provisioned, "talker", f">{subject}<", "> <")
    said = keymint("prove", "-w", provisioned, "talker").err
    for model, reason in (
        ("omg", "no grant applies to"),
        ("cyclonedds-0.10", "Cyclone DDS refuses a grant without a subject name"),
        ("fastdds-2.11", "Fast DDS refuses a grant without a subject name"),
    ):
        lines = [line for line in said.splitlines() if f"[{model}]" in line]
        assert lines, said
        assert all(reason in line for line in lines)


def test_what_a_vendor_makes_of_an_odd_document_may_be_unknown(keymint: Callable, provisioned: Path):
    resign(provisioned, "talker", "</topics>", "</topics><topics><topic>rt/chatter</topic></topics>")
    outcome = keymint("prove", "-w", provisioned, "talker", "--json")
    assert outcome.code == 3
    (enclave,) = outcome.document["result"]["enclaves"]
    unknown = [claim for claim in enclave["claims"] if claim["proof"] == "unknown"]
    assert {claim["model"] for claim in unknown} == {"cyclonedds-0.10", "fastdds-2.11"}
    assert all("reads what the schema does not allow" in claim["reason"] for claim in unknown)
    said = keymint("prove", "-w", provisioned, "talker").err
    assert "/talker, publish and subscribe: not proven for fastdds-2.11" in said
    assert "--seconds" not in said, "more time would not help"


def test_an_enclave_without_sources_is_not_proven(keymint: Callable, provisioned: Path):
    shutil.rmtree(provisioned / "src/talker")
    outcome = keymint("prove", "-w", provisioned)
    assert outcome.code == 3
    assert "the enclave /talker is installed, but has no source package" in outcome.err


@pytest.mark.parametrize("subject", ["/talker", "/"])
def test_what_vendors_decide_differently_can_be_accepted(keymint: Callable, tmp_path: Path, subject: str):
    policy = tmp_path / "policy.xml"
    policy.write_text(
        f'<profiles><profile name="p"><attachment>{subject}</attachment><topic qualifier="ALLOW">'
        "<attachment>rt/a\\[</attachment><permissions><publish/></permissions></topic></profile></profiles>"
    )
    made = keymint("provision", policy, "-w", "ws", "--allow-vendor-specific")
    assert made.code == 0, made.err
    refused = keymint("install", "-w", "ws")
    assert refused.code == 3
    assert "--allow-vendor-specific" in refused.err
    assert keymint("install", "-w", "ws", "--allow-vendor-specific").code == 0
    assert keymint("prove", "-w", "ws").code == 3
    accepted = keymint("prove", "-w", "ws", "--allow-vendor-specific")
    assert accepted.code == 0
    assert accepted.out.startswith("proved 1 enclave for omg: 3 of 3 claims proven; in force at 2027-01-15T08:00:00Z")


def test_a_busy_machine_proves_the_same(
    keymint: Callable, provisioned: Path, policy: Path, monkeypatch: pytest.MonkeyPatch
):
    policy.write_text(policy.read_text().replace("/chatter", "/chat*"))
    hours = itertools.count(0, 3600)
    monkeypatch.setattr(time, "monotonic", lambda: float(next(hours)))
    for verb in (("create", "--all"), ("build",), ("install",), ("prove",)):
        outcome = keymint(*verb, "-w", provisioned)
        assert outcome.code == 0, outcome.err


def test_what_is_too_costly_names_the_rules_and_a_way_out(keymint: Callable, provisioned: Path, policy: Path):
    policy.write_text(policy.read_text().replace("/chatter", "/chat*"))
    said = keymint("prove", "-w", provisioned, "--states=1").err
    assert "not decided within 1 states; the rules with the most wildcards are at policy.xml:5" in said
    assert f"'keymint prove --states 5000000 -w {provisioned}'" in said


def test_the_steps_of_an_enclave_are_limited(
    keymint: Callable, provisioned: Path, policy: Path, monkeypatch: pytest.MonkeyPatch
):
    policy.write_text(policy.read_text().replace("/chatter", "/chat*"))
    monkeypatch.setattr(proof_results, "STEPS", 10)
    outcome = keymint("prove", "-w", provisioned, "--states=1")
    assert outcome.code == 3
    assert "policy.xml:5" in outcome.err
