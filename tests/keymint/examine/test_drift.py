# SPDX-License-Identifier: Apache-2.0
"""A keystore and its policy drift apart: ``check`` and ``prove`` find it in both directions, by meaning."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from .presented import codes, findings, notes

VERBS = ("check", "prove")
RULE = """<ros_topic qualifier="ALLOW">
      <attachment>/chatter</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>"""


def edit(ws: Path, old: str, new: str) -> None:
    """Change the policy, which lies beside the workspace, and nothing else."""
    path = ws.parent / "policy.xml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("verb", VERBS)
def test_a_right_that_the_keystore_still_grants(keymint, provisioned: Path, verb: str) -> None:
    edit(provisioned, RULE, "")
    found = findings(keymint, provisioned, verb)
    assert any("permits it to publish 'rt/chatter'" in each["message"] for each in found)
    assert {each["subject"] for each in found if each["code"] == "counterexample"} == {"/talker"}


@pytest.mark.parametrize("verb", VERBS)
def test_a_right_that_the_keystore_does_not_grant_yet(keymint, provisioned: Path, verb: str) -> None:
    edit(provisioned, RULE, RULE + RULE.replace("/chatter", "/more"))
    found = findings(keymint, provisioned, verb)
    assert any("does not permit it to publish 'rt/more'" in each["message"] for each in found)


def test_check_names_the_policy_as_the_cause(keymint, provisioned: Path) -> None:
    edit(provisioned, RULE, "")
    document = keymint("check", "--json", cwd=provisioned).document
    (cause,) = (each for each in document["diagnostics"] if each["code"] == "policy-changed")
    assert (cause["file"], cause["severity"]) == ("../policy.xml", "warning")
    assert "'keymint provision ../policy.xml'" in cause["help"]


@pytest.mark.parametrize("verb", VERBS)
def test_another_text_of_the_same_meaning_is_no_drift(keymint, provisioned: Path, verb: str) -> None:
    edit(provisioned, RULE, f"<!-- twice -->{RULE}{RULE}")
    assert codes(keymint, provisioned, verb) == set()


@pytest.mark.parametrize("verb", VERBS)
def test_a_subject_that_no_profile_names_any_more(keymint, provisioned: Path, verb: str) -> None:
    edit(provisioned, "<attachment>/robot1/listener</attachment>", "<attachment>/robot2/listener</attachment>")
    found = [each for each in findings(keymint, provisioned, verb) if each["code"] == "counterexample"]
    assert any("/robot1/listener: the document permits it to subscribe" in each["message"] for each in found)


def test_no_prove_leaves_the_comparison_out_and_says_so(keymint, provisioned: Path) -> None:
    edit(provisioned, RULE, "")
    outcome = keymint("check", "--no-prove", cwd=provisioned)
    assert "not proven, because of --no-prove" in outcome.out
    assert "counterexample" not in codes(keymint, provisioned, "check", "--no-prove")


@pytest.mark.parametrize("fresh", [(), ("--fresh",)])
def test_check_tells_in_json_whether_it_proved(keymint, provisioned: Path, fresh: tuple[str, ...]) -> None:
    assert keymint("check", *fresh, "--json", cwd=provisioned).document["result"]["proven"] is True
    assert keymint("check", "--no-prove", "--json", cwd=provisioned).document["result"]["proven"] is False


class TestAPolicyThatCannotBeRead:
    """It is one finding, and the verbs answer the rest."""

    @pytest.fixture
    def unread(self, provisioned: Path) -> Path:
        edit(provisioned, "</profiles>", "<")
        return provisioned

    @pytest.mark.parametrize("verb", VERBS)
    def test_it_is_one_finding(self, keymint, unread: Path, verb: str) -> None:
        found = findings(keymint, unread, verb)
        assert [(each["severity"], Path(each["file"]).name) for each in found if each["code"] != "policy-changed"] == [
            ("error", "policy.xml")
        ]

    @pytest.mark.parametrize("verb", VERBS)
    def test_the_rest_is_answered(self, keymint, unread: Path, verb: str) -> None:
        foreign = (unread / "public/permissions_ca.cert.pem").read_bytes()
        (unread / "install/enclaves/talker/identity_ca.cert.pem").write_bytes(foreign)
        assert any("talker/identity_ca.cert.pem" in (each["file"] or "") for each in findings(keymint, unread, verb))


@pytest.mark.parametrize("verb", VERBS)
def test_a_subject_that_was_never_created_is_a_note(keymint, provisioned: Path, verb: str) -> None:
    edit(provisioned, "</profiles>", '<profile name="extra"><attachment>/extra</attachment></profile></profiles>')
    assert codes(keymint, provisioned, verb) == set()
    (note,) = notes(keymint(verb, "--json", cwd=provisioned), "subjects-uncreated")
    assert "/extra" in note["message"]


@pytest.mark.parametrize("verb", VERBS)
def test_a_subject_without_sources_has_the_rights_of_its_policy(keymint, provisioned: Path, verb: str) -> None:
    """Its certificate is in force until it is revoked, and its last document permits what the policy still says."""
    shutil.rmtree(provisioned / "src/robot1")
    assert keymint("install", "--prune", cwd=provisioned).code == 0
    assert notes(keymint(verb, "--json", cwd=provisioned), "rights-outlive") == []
    edit(provisioned, "<ros_subscribe/>", "<ros_publish/>")
    (note,) = notes(keymint(verb, "--json", cwd=provisioned), "rights-outlive")
    assert "/robot1/listener more than the policy, e.g. to subscribe 'rt/chatter'" in note["message"]
