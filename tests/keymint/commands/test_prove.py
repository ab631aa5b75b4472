"""``keymint prove``: proven, refuted, unknown; and what the record saves."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from keymint.pki import certificates, keys, smime
from tests.conftest import NOW


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
    assert "12 of 12 claims proven" in outcome.out
    document = keymint("prove", "-w", provisioned, "--json").document
    assert set(document["result"]["assumptions"]) == {"omg", "cyclonedds-0.10", "fastdds-2.9"}
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
        assert one["dds_name"] == "rt/chatter"
        assert one["ros"] == {"kind": "ros_topic", "permission": "ros_publish", "name": "/chatter"}
        assert one["policy"]["allowed"] is True
        assert (one["policy"]["file"], one["policy"]["line"]) == ("policy.xml", 5)
        assert one["document"]["allowed"] is False
        assert one["document"]["line"] > 0
    said = keymint("prove", "-w", provisioned, "talker").err
    assert "policy.xml:5: error: /talker: the document does not permit it to publish 'rt/chatter'" in said
    assert said.count("error:") == 1, "what all models have in common is said once"


def test_what_was_proven_is_not_proven_again_until_something_changes(keymint: Callable, provisioned: Path):
    keymint("prove", "-w", provisioned)

    def unchanged() -> list[bool]:
        found = keymint("prove", "-w", provisioned, "--json").document["result"]["enclaves"]
        return [one["unchanged"] for one in found]

    assert unchanged() == [True, True]
    resign(provisioned, "talker", "rt/chatter", "rt/chatte?")
    assert unchanged() == [True, False]
    assert unchanged() == [True, False], "what is refuted is not remembered"
    keymint("install", "-w", provisioned)
    keymint("prove", "-w", provisioned)
    assert unchanged() == [True, True]


def test_the_policy_is_what_counts_and_not_what_was_built(keymint: Callable, provisioned: Path, policy: Path):
    keymint("prove", "-w", provisioned)
    policy.write_text(policy.read_text().replace("/chatter", "/chat*"))
    outcome = keymint("prove", "-w", provisioned)
    assert outcome.code == 3
    assert "'rt/chat'" in outcome.err


@pytest.mark.parametrize("option", ["--states=1", "--seconds=0"])
def test_what_is_not_decided_is_unknown_and_a_finding(keymint: Callable, provisioned: Path, policy: Path, option: str):
    policy.write_text(policy.read_text().replace("/chatter", "/chat*"))
    outcome = keymint("prove", "-w", provisioned, option, "--json")
    assert outcome.code == 3
    assert "not-proven" in outcome.codes()


def test_an_enclave_that_cannot_be_read(keymint: Callable, provisioned: Path):
    (provisioned / "install/enclaves/talker/permissions.p7s").write_bytes(b"nonsense")
    outcome = keymint("prove", "-w", provisioned)
    assert outcome.code == 3
    assert "could not be read" in outcome.out
    assert "Traceback" not in outcome.err


def test_an_enclave_that_is_not_installed(keymint: Callable, provisioned: Path):
    for path in (provisioned / "install/enclaves/talker").iterdir():
        path.unlink()
    outcome = keymint("prove", "-w", provisioned, "talker", "--json")
    assert outcome.code == 3
    assert "enclave-missing" in outcome.codes()


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
    assert "build/talker/permissions.xml: error: was edited by hand" in outcome.err, "the cause is reported as well"
    assert "--allow-vendor-specific" not in outcome.err, "the standard is at odds with it as well"
    assert keymint("install", "--no-prove", "-w", provisioned).code == 0
    assert installed.read_bytes() != before, "unless that is asked for"


def test_what_install_proved_is_known_to_prove(keymint: Callable, provisioned: Path):
    assert keymint("install", "-w", provisioned).code == 0
    found = keymint("prove", "-w", provisioned, "--json").document["result"]["enclaves"]
    assert [one["unchanged"] for one in found] == [True, True]


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
        ("fastdds-2.9", "Fast DDS refuses a grant without a subject name"),
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
    assert {claim["model"] for claim in unknown} == {"cyclonedds-0.10", "fastdds-2.9"}
    assert all("reads what the schema does not allow" in claim["reason"] for claim in unknown)
    said = keymint("prove", "-w", provisioned, "talker").err
    assert "/talker, publish and subscribe: not proven for fastdds-2.9" in said
    assert "--seconds" not in said, "more time would not help"


def test_an_enclave_without_sources_is_not_proven(keymint: Callable, provisioned: Path):
    shutil.rmtree(provisioned / "src/talker")
    outcome = keymint("prove", "-w", provisioned)
    assert outcome.code == 3
    assert "the enclave /talker is installed, but has no source package" in outcome.err


def test_what_vendors_decide_differently_can_be_accepted(keymint: Callable, tmp_path: Path):
    policy = tmp_path / "policy.xml"
    policy.write_text(
        '<profiles><profile name="p"><attachment>/talker</attachment><topic qualifier="ALLOW">'
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
    assert accepted.out.startswith("proved 1 enclave for omg: 2 of 2 claims proven; in force at 2027-01-15T08:00:00Z")


@pytest.fixture
def stranger(keymint: Callable, policy: Path, tmp_path: Path) -> Path:
    """The enclaves of another workspace on the same policy, with authorities of its own."""
    assert keymint("provision", policy, "-w", "other").code == 0
    return tmp_path / "other/install/enclaves"


def test_an_enclave_of_another_workspace_is_a_finding_of_every_verb(
    keymint: Callable, provisioned: Path, stranger: Path
):
    keymint("prove", "-w", provisioned)
    enclave = provisioned / "install/enclaves/talker"
    shutil.rmtree(enclave)
    shutil.copytree(stranger / "talker", enclave)
    proved = keymint("prove", "-w", provisioned, "--json")
    assert proved.code == 3
    assert {"authority-differs", "smime-signer", "chain-signature"} & set(proved.codes())
    by_name = {one["subject"]: one for one in proved.document["result"]["enclaves"]}
    assert by_name["/talker"]["proof"] == "unknown"
    assert by_name["/talker"]["claims"] == []
    assert by_name["/robot1/listener"]["proof"] == "proven"
    assert "'keymint install' restores it" in keymint("prove", "-w", provisioned).err
    for arguments in (["verify", "-t", "omg"], ["why", "/talker", "ros_publish", "/chatter", "-t", "omg"]):
        outcome = keymint(*arguments, "-w", provisioned, "--json")
        assert outcome.code == 3, "its own authorities permit it, but they are not ours"
        found = [each for each in outcome.document["diagnostics"] if each["code"] == "authority-differs"]
        assert len(found) == 2
        assert {each["subject"] for each in found} == {"/talker"}
    assert keymint("install", "-w", provisioned).code == 0
    assert keymint("prove", "-w", provisioned).code == 0


def test_a_key_that_was_replaced_is_found_though_the_proof_is_remembered(
    keymint: Callable, provisioned: Path, stranger: Path
):
    assert keymint("prove", "-w", provisioned).code == 0
    (provisioned / "install/enclaves/talker/key.pem").write_bytes((stranger / "talker/key.pem").read_bytes())
    outcome = keymint("prove", "-w", provisioned, "--json")
    assert outcome.code == 3
    assert "key-mismatch" in outcome.codes()


@pytest.mark.parametrize("role", ["identity_ca", "permissions_ca"])
def test_without_the_workspaces_authority_nothing_is_proven(keymint: Callable, provisioned: Path, role: str):
    assert keymint("prove", "-w", provisioned).code == 0
    (provisioned / f"public/{role}.cert.pem").unlink()
    for arguments in (["prove"], ["verify", "-t", "omg"], ["why", "/talker", "ros_publish", "/chatter", "-t", "omg"]):
        outcome = keymint(*arguments, "-w", provisioned)
        assert outcome.code == 3, outcome.out
        assert f"public/{role}.cert.pem: error: the certificate of the authority '{role}' is missing" in outcome.err
        assert "restore it from a copy of the workspace" in outcome.err


YEAR = 365 * 24 * 3600
BEFORE = {"SOURCE_DATE_EPOCH": str(NOW - YEAR)}
AFTER = {"SOURCE_DATE_EPOCH": str(NOW + 2 * YEAR)}


def test_a_proof_says_at_which_time_it_holds_and_until_when(keymint: Callable, provisioned: Path):
    outcome = keymint("prove", "-w", provisioned)
    assert "; in force at 2027-01-15T08:00:00Z, until 2028-01-14T00:00:00Z" in outcome.out
    result = keymint("prove", "-w", provisioned, "--json").document["result"]
    assert (result["at"], result["until"]) == ("2027-01-15T08:00:00Z", "2028-01-14T00:00:00Z")
    assert {one["until"] for one in result["enclaves"]} == {"2028-01-14T00:00:00Z"}
    assert {claim["until"] for one in result["enclaves"] for claim in one["claims"]} == {"2028-01-14T00:00:00Z"}


@pytest.mark.parametrize(
    ("clock", "codes"),
    [
        (AFTER, {"grant-expired", "certificate-expired"}),
        (BEFORE, {"grant-not-yet-valid", "certificate-not-yet-valid", "authority-not-yet-valid"}),
    ],
)
@pytest.mark.parametrize("remembered", [False, True])
def test_what_is_not_in_force_is_a_finding_though_its_proof_is_remembered(
    keymint: Callable, provisioned: Path, clock: dict[str, str], codes: set[str], remembered: bool
):
    if not remembered:
        (provisioned / ".keymint/state.json").unlink()
    outcome = keymint("prove", "-w", provisioned, "--json", env=clock)
    assert outcome.code == 3
    assert set(outcome.codes()) - {"assumption"} == codes
    result = outcome.document["result"]
    assert result["until"] is None
    assert [one["unchanged"] for one in result["enclaves"]] == [remembered, remembered]
    assert {one["until"] for one in result["enclaves"]} == {None}
    grants = [one for one in outcome.document["diagnostics"] if one["code"].startswith("grant-")]
    assert [one["file"].endswith("permissions.xml") and one["line"] > 0 for one in grants] == [True, True]
    said = keymint("prove", "-w", provisioned, env=clock)
    assert "; 2 enclaves are not in force at" in said.out
    assert said.err.count("the certificate of 'CN=permissions_ca'") <= 1, (
        "what enclaves have in common is reported once"
    )


def test_a_remembered_proof_says_its_places_from_where_the_user_stands(keymint: Callable, provisioned: Path):
    for cwd, shown in ((provisioned.parent, "ws/install/"), (provisioned, "install/"), (provisioned / "src", "../ins")):
        found = keymint("prove", "-w", provisioned, "talker", cwd=cwd, env=AFTER).err
        assert f"\n{shown}" in f"\n{found}", found
        assert "enclaves/talker/permissions.xml:" in found


def test_vendors_that_read_a_date_differently_are_told_apart(keymint: Callable, provisioned: Path):
    # Fast DDS ignores the zone: for it this grant ended seven hours ago, for the others it ends in an hour.
    resign(provisioned, "talker", "2028-01-14T00:00:00</not_after>", "2027-01-15T01:00:00-08:00</not_after>")
    outcome = keymint("prove", "-w", provisioned, "talker", "--json")
    assert outcome.code == 3
    found = [one for one in outcome.document["diagnostics"] if one["code"] == "grant-expired"]
    assert len(found) == 1
    assert "expired on 2027-01-15T01:00:00Z, as fastdds-2.9 reads its dates" in found[0]["message"]
    (enclave,) = outcome.document["result"]["enclaves"]
    assert {claim["model"]: claim["until"] for claim in enclave["claims"]} == {
        "omg": "2027-01-15T09:00:00Z",
        "cyclonedds-0.10": "2027-01-15T09:00:00Z",
        "fastdds-2.9": None,
    }
