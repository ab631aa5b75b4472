# SPDX-License-Identifier: Apache-2.0
"""``keymint provision``."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import snapshot


def test_all_in_one_go(keymint, policy: Path, tmp_path: Path) -> None:
    outcome = keymint("provision", policy, "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert keymint("check", "-w", "ws").code == 0


def test_the_policy_of_the_paper(keymint, reference: Path, tmp_path: Path) -> None:
    outcome = keymint("provision", reference / "ppac/comarmor.d", "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert {path.name for path in (tmp_path / "ws/install/enclaves").iterdir() if path.is_dir()} == {
        "talker",
        "listener",
    }
    assert keymint("check", "-w", "ws").code == 0


def test_a_second_run_writes_not_one_file(keymint, just_provisioned: Path, policy: Path) -> None:
    before = snapshot(just_provisioned)
    outcome = keymint("provision", policy, "-w", "ws")
    assert "nothing to do: 2 packages up to date" in outcome.out
    assert snapshot(just_provisioned) == before


def test_only_what_a_change_concerns_is_signed_again(keymint, provisioned: Path, policy: Path) -> None:
    before = snapshot(provisioned / "install")
    policy.write_text(policy.read_text().replace("<permissions><ros_subscribe/>", "<permissions><ros_publish/>"))
    assert keymint("provision", policy, "-w", "ws").code == 0
    after = snapshot(provisioned / "install")
    changed = {path for path in before if before[path][2] != after[path][2]}
    assert changed == {f"enclaves/robot1/listener/permissions.{end}" for end in ("p7s", "xml")}


def test_a_comment_in_the_policy_builds_nothing(keymint, provisioned: Path, policy: Path) -> None:
    before = snapshot(provisioned / "build"), snapshot(provisioned / "install")
    policy.write_text("<!-- reviewed -->\n" + policy.read_text())
    assert keymint("provision", policy, "-w", "ws").code == 0
    assert (snapshot(provisioned / "build"), snapshot(provisioned / "install")) == before


def test_another_policy_for_the_same_workspace(keymint, provisioned: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.xml"
    other.write_text("<profiles><profile name='x'><attachment>/x</attachment></profile></profiles>")
    outcome = keymint("provision", other, "-w", "ws", "--yes")
    assert outcome.code == 0, outcome.err
    assert (provisioned / "install/enclaves/x/key.pem").is_file()
    assert "no profile of the policy applies to /talker any more" in outcome.err


def test_a_file_that_comes_into_being_beside_the_policy_is_seen(keymint, provisioned: Path, policy: Path) -> None:
    """The record must not hide that an include is found elsewhere now."""
    own = policy.parent / "common"
    own.mkdir()
    (own / "node.xml").write_text(
        "<ros_topic qualifier='ALLOW'><attachment>/mine</attachment>"
        "<permissions><ros_publish/></permissions></ros_topic>"
    )
    assert keymint("provision", policy, "-w", "ws").code == 0
    document = (provisioned / "install/enclaves/talker/permissions.xml").read_text()
    assert "rt/mine" in document
    assert "rt/rosout" not in document


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "policy.xml"),
        ("<profiles>", "policy.xml:1"),
        ("<profiles/>", "names no subject exactly"),
        ("<!DOCTYPE profiles [<!ENTITY a 'b'>]><profiles/>", "DOCTYPE"),
        ("<profiles><profile name='a'><attachment>../etc</attachment></profile></profiles>", "policy.xml:1"),
        ("<profiles><profile name='a'><attachment>/a/../b</attachment></profile></profiles>", "policy.xml:1"),
        ("<profiles><profile name='a'><attachment>/a</attachment><ros_topc/></profile></profiles>", "ros_topic"),
    ],
)
def test_a_bad_policy_leaves_nothing_behind(keymint, tmp_path: Path, text: str, expected: str) -> None:
    (tmp_path / "policy.xml").write_text(text)
    outcome = keymint("provision", "policy.xml", "-w", "ws")
    assert outcome.code == 1
    assert expected in outcome.err
    assert [path.name for path in tmp_path.iterdir()] == ["policy.xml"]


def test_a_bad_policy_leaves_a_workspace_as_it_was(keymint, provisioned: Path, policy: Path) -> None:
    before = snapshot(provisioned)
    policy.write_text(policy.read_text().replace("ros_publish", "ros_publsh"))
    outcome = keymint("provision", policy, "-w", "ws")
    assert outcome.code == 1
    assert "did you mean" in outcome.err
    assert snapshot(provisioned) == before


def test_a_missing_policy(keymint, tmp_path: Path) -> None:
    outcome = keymint("provision", "nowhere", "-w", "ws")
    assert outcome.code == 1
    assert "nowhere: error: no such file or folder" in outcome.err


def test_names_beyond_what_x509_holds(keymint, tmp_path: Path) -> None:
    long = "/" + "/".join(f"segment_{n}" for n in range(12)) + "/driver"
    deep = "/" + "/".join("abcdefghijklmnopqrstuvwxyz") + "/driver"
    (tmp_path / "p.xml").write_text(
        f"<profiles><profile name='a'><attachment>{long}</attachment>"
        f"<attachment>{deep}</attachment></profile></profiles>"
    )
    outcome = keymint("provision", "p.xml", "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert keymint("check", "-w", "ws").code == 0


def test_the_bare_cn_of_sros2_on_request(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "ws", "--subject-format", "sros2").code == 0
    document = (tmp_path / "ws/build/robot1/listener/permissions.xml").read_text()
    assert "<subject_name>CN=/robot1/listener</subject_name>" in document


def test_and_a_second_rdn_by_default(provisioned: Path) -> None:
    document = (provisioned / "build/robot1/listener/permissions.xml").read_text()
    assert "<subject_name>CN=/robot1/listener,OU=" in document


def test_a_domain_of_ones_own(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "ws", "--domain", "42").code == 0
    for file in ("permissions.xml", "governance.xml"):
        assert "<id>42</id>" in (tmp_path / "ws/build/talker" / file).read_text()


@pytest.mark.parametrize("verb", ["init", "provision"])
def test_an_unknown_distribution_is_a_usage_error_also_for_an_existing_workspace(
    keymint, policy: Path, verb: str
) -> None:
    arguments = ("--policy", policy, "ws") if verb == "init" else (policy, "-w", "ws")
    new = keymint(verb, *arguments, "--distro", "nosuch")
    assert keymint(verb, *arguments).code == 0
    again = keymint(verb, *arguments, "--distro", "nosuch")
    assert (new.code, again.code) == (2, 2)
    assert "nosuch" in again.err


class TestWorkspaceOf2018:
    """The format that this kind of tool had in 2018 loads, unmodified."""

    @pytest.fixture
    def ws(self, reference: Path, tmp_path: Path) -> Path:
        for path in sorted((reference / "ppac/keymint_ws").rglob("*.xml")):
            target = tmp_path / "ws" / path.relative_to(reference / "ppac/keymint_ws")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        return tmp_path / "ws"

    def test_is_created_built_and_installed(self, keymint, ws: Path) -> None:
        status = keymint("status", cwd=ws)
        assert status.code == 0
        assert "keymint create talker" in status.out
        for arguments in (("create", "--all"), ("build",), ("install",)):
            outcome = keymint(*arguments, cwd=ws)
            assert outcome.code == 0, outcome.err
        outcome = keymint("check", "--json", cwd=ws)
        assert outcome.code == 3
        for finding in outcome.document["diagnostics"]:
            assert "expire" in finding["code"] + finding["message"] or finding["severity"] in {"warning", "note"}, (
                finding
            )

    def test_its_permissions_are_not_lost(self, keymint, ws: Path) -> None:
        old = (ws / "src/talker/permissions.xml").read_bytes()
        keymint("create", "talker", cwd=ws)
        assert old in [path.read_bytes() for path in (ws / "src/talker").iterdir()]


def test_new_subjects_whose_nodes_cannot_start_are_noted_once(keymint, policy: Path) -> None:
    whole = policy.read_text()
    policy.write_text(re.sub(r" *<xi:include[^>]*>\n?", "", whole))
    assert policy.read_text() != whole
    first = keymint("provision", policy, "-w", "ws", "--json").document
    notes = [each for each in first["diagnostics"] if each["code"] == "node-cannot-start"]
    assert notes
    assert all(each["severity"] == "note" and each["line"] and "common/node.xml" in each["help"] for each in notes)
    assert "note: /talker: a node of this subject cannot start" in keymint("provision", policy, "-w", "other").err
    assert keymint("provision", policy, "-w", "ws").err == ""


def test_an_authority_without_its_key_is_noted_each_time(keymint, policy: Path) -> None:
    assert keymint("provision", policy, "-w", "ws").code == 0
    (policy.parent / "ws/private/identity_ca.key.pem").unlink()
    for _ in range(3):
        outcome = keymint("provision", policy, "-w", "ws")
        assert (outcome.code, outcome.out) == (0, "nothing to do: 2 packages up to date\n")
        assert "note: the private key of 'identity_ca' is not here" in outcome.err


@pytest.mark.parametrize("verb", [("provision", "policy.xml", "-w", "ws"), ("init", "ws")], ids=" ".join)
def test_a_lost_profile_is_not_made_again_with_defaults(
    keymint: Callable, just_provisioned: Path, verb: tuple[str, ...]
) -> None:
    marker = just_provisioned / "profile/keymint_profile.xml"
    marker.unlink()
    before = snapshot(just_provisioned)
    refused = keymint(*verb)
    assert (refused.code, refused.err.count("\n")) == (1, 1)
    assert refused.err.startswith("ws/profile/keymint_profile.xml: error: is missing, but the workspace has packages")
    assert snapshot(just_provisioned) == before
    assert keymint(*verb, "--distro", "jazzy").code == 0
    assert keymint("provision", "policy.xml", "-w", "ws").code == 0
    assert "<distro>jazzy</distro>" in marker.read_text()
    assert keymint("check", "-w", "ws").code == 0


@pytest.mark.parametrize("verb", [("provision", "../policy.xml"), ("init",)], ids=" ".join)
def test_the_current_folder_becomes_a_workspace_but_not_silently_and_not_home(
    keymint: Callable, policy: Path, verb: tuple[str, ...]
) -> None:
    folder = policy.parent / "here"
    folder.mkdir()
    refused = keymint(*verb, cwd=folder, env={"HOME": str(folder)})
    assert (refused.code, "would become a workspace" in refused.err) == (2, True)
    assert [*folder.iterdir()] == []
    made = keymint(*verb, cwd=folder)
    assert made.out.startswith("created   init        workspace profile, in the current folder\n")
    assert keymint(*verb, cwd=folder, env={"HOME": str(folder)}).code == 0


def test_the_keystore_of_a_workspace_is_no_workspace(keymint, provisioned: Path, policy: Path) -> None:
    outcome = keymint("provision", policy, "-w", provisioned / "install")
    assert outcome.code == 1
    assert (
        "is a keystore of a workspace, and no workspace (name the workspace: -w ws) [workspace-keystore]" in outcome.err
    )
