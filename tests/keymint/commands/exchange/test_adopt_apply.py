# SPDX-License-Identifier: Apache-2.0
"""``keymint adopt --apply``: the workspace has what the robots have, and the next installation changes nothing."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tests import sros2_keystore
from tests.conftest import NOW

from .test_adopt import POLICY, made, snapshot


@pytest.fixture(autouse=True)
def policy_of_sros2(tmp_path: Path) -> Path:
    path = tmp_path / "policy.xml"
    path.write_text(POLICY)
    return path


def files(folder: Path, *parts: str) -> Mapping[str, tuple[str, bytes]]:
    """Return the files and links below some folders, without modes."""
    found = snapshot(folder)
    return {
        path: (link, content)
        for path, (link, _, content) in found.items()
        if (content or link) and (not parts or path.startswith(parts))
    }


def complete(outcome) -> str:
    assert outcome.code == 0, outcome.err
    return outcome.out


@pytest.mark.parametrize(
    "form", [{}, {"two": True, "domain": 7}, {"zone": True, "graph": True}], ids=["one authority", "two", "zone"]
)
def test_build_and_install_change_nothing(keymint, tmp_path: Path, form: Mapping[str, object]) -> None:
    keystore = made(tmp_path / "ks", **form)
    before = snapshot(keystore)
    assert "equal to the policy" in complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    assert snapshot(keystore) == before
    robots = files(keystore, "enclaves/", "public/")
    assert files(tmp_path / "ws/install", "enclaves/", "public/") == robots
    after = snapshot(tmp_path / "ws/install")
    complete(keymint("create", "--all", "-w", "ws"))
    complete(keymint("build", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))
    complete(keymint("build", "-f", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))
    assert snapshot(tmp_path / "ws/install") == after
    assert keymint("prove", "-w", "ws").code == 0


def test_what_vendors_read_differently_stays_and_is_said(keymint, tmp_path: Path) -> None:
    """Cyclone DDS denies both directions of a topic of which one is denied: robots live with it already."""
    policy = POLICY.replace('publish="ALLOW"', 'publish="ALLOW" subscribe="DENY"', 1)
    (tmp_path / "policy.xml").write_text(policy)
    sros2_keystore.make(tmp_path / "ks", policy)
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    complete(keymint("build", "-w", "ws"))
    outcome = keymint("install", "-w", "ws")
    assert outcome.code == 0
    assert "warning: /talker: the document does not permit it to publish 'rt/chatter'" in outcome.err
    assert files(tmp_path / "ws/install", "enclaves/") == files(tmp_path / "ks", "enclaves/")
    new = tmp_path / "ws/profile/comarmor.d/policy.xml"
    new.write_text(new.read_text().replace("/talker/get_parameters", "/talker/other"))
    complete(keymint("create", "--all", "-w", "ws"))
    complete(keymint("build", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))  # what is signed again means the same to all vendors
    assert keymint("prove", "-w", "ws").code == 0


def test_without_a_policy_one_is_made_from_what_is_signed(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "--apply", "-w", "ws"))
    robots = files(keystore, "enclaves/", "public/")
    complete(keymint("create", "--all", "-w", "ws"))
    complete(keymint("build", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))
    assert files(tmp_path / "ws/install", "enclaves/", "public/") == robots
    assert keymint("diff", "policy.xml", "ws/profile/comarmor.d/adopted.xml").out.startswith("equivalent")


@pytest.mark.parametrize("policy", [["policy.xml"], ["imported"], []], ids=["sros2", "comarmor", "learned"])
def test_sources_name_the_files_of_the_workspace(keymint, tmp_path: Path, policy: list[str]) -> None:
    """The places of rules are those that the next 'create' writes, and none is in the installation of Keymint."""
    made(tmp_path / "ks")
    complete(keymint("import", "policy.xml", "-o", "imported"))
    complete(keymint("adopt", "ks", *policy, "--apply", "-w", "ws"))
    texts = {path: path.read_text() for path in (tmp_path / "ws/src").rglob("permissions.xml")}
    assert len(texts) == 2
    origins = [each for text in texts.values() for each in re.findall('origin="(.*?)"', text)]
    places = {place for origin in origins for place in origin.split("; ")}
    assert places
    assert all(each.startswith(("comarmor.d/", f"{tmp_path}/imported/")) for each in places)
    for name in ("talker", "listener"):
        keymint("create", name, "-w", "ws")
    assert {path: path.read_text() for path in texts} == texts


def test_secrets_are_private_wherever_they_are(keymint, tmp_path: Path) -> None:
    sros2_keystore.make(tmp_path / "ks", POLICY)  # all files are 0644, as SROS2 leaves them
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 0
    assert "ks/private/ca.key.pem: warning: is the private key of the authority 'ca', which ws/private/ca.key.pem" in (
        outcome.err
    )
    keys = sorted((tmp_path / "ws").rglob("*key.pem"))
    assert [str(key.relative_to(tmp_path / "ws")) for key in keys] == [
        "install/enclaves/robot1/listener/key.pem", "install/enclaves/talker/key.pem", "private/ca.key.pem",
        "private/identities/robot1/listener/key.pem", "private/identities/talker/key.pem",
    ]  # fmt: skip
    assert {key.stat().st_mode & 0o777 for key in keys} == {0o600}
    for key in (tmp_path / "ks").rglob("*key.pem"):
        assert key.read_text() not in outcome.out + outcome.err


def test_the_register_knows_what_was_issued(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    issued = keymint("issued", "-w", "ws", "--json").document["result"]["certificates"]
    assert sorted(each["subject"] for each in issued) == ["/robot1/listener", "/talker"]
    assert keymint("revoke", "talker", "--reason", "key-compromise", "-w", "ws").code == 0


@pytest.mark.parametrize("layout", ["rti", "flat"])
def test_other_layouts(keymint, tmp_path: Path, layout: str) -> None:
    made(tmp_path / "ks", layout=layout)
    implicit = ("--no-implicit",) if layout == "flat" else ()
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws", *implicit))
    after = snapshot(tmp_path / "ws/install")
    signed = {content for path, (_, content) in files(tmp_path / "ks").items() if path.endswith(".p7s")}
    assert {content for path, (_, content) in files(tmp_path / "ws/install").items() if path.endswith(".p7s")} == signed
    complete(keymint("build", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))
    assert snapshot(tmp_path / "ws/install") == after


def test_keys_that_are_elsewhere_stay_there(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks")
    shutil.rmtree(keystore / "private")
    (keystore / "enclaves/talker/key.pem").unlink()
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    assert not (tmp_path / "ws/private/ca.key.pem").exists()
    assert files(tmp_path / "ws/install", "enclaves/") == files(keystore, "enclaves/")
    complete(keymint("build", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))
    assert files(tmp_path / "ws/install", "enclaves/") == files(keystore, "enclaves/")
    outcome = keymint("renew", "talker", "-w", "ws", "--json")
    assert outcome.code == 1
    assert "authority-key-missing" in {each["code"] for each in outcome.document["diagnostics"]}


@pytest.mark.parametrize(
    ("old", "new", "relation", "words"),
    [
        ("</topics>", "<topic>more</topic></topics>", "narrower", "does not permit publish 'rt/more'"),
        ("<topic>chatter</topic>", "<topic>chat</topic>", "different", "'rt/chat'"),
        ('<services reply="ALLOW"><service>~/get_parameters</service></services>', "", "wider", "permits"),
    ],
)  # fmt: skip
def test_a_policy_that_says_something_else(
    keymint, tmp_path: Path, old: str, new: str, relation: str, words: str
) -> None:
    made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY.replace(old, new, 1))
    outcome = keymint("adopt", "ks", "policy.xml", "--json")
    assert outcome.code == 3
    assert outcome.document["result"]["enclaves"][1]["policy"]["relation"] == relation
    assert outcome.document["result"]["enclaves"][0]["policy"]["relation"] == "equal"
    refused = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert refused.code == 1
    assert f"talker/permissions.p7s: error: is {relation} in comparison with the policy" in refused.err
    assert words in refused.err
    assert not (tmp_path / "ws").exists()


def test_an_authority_that_ends_with_all_that_it_issued_is_due_with_it(keymint, tmp_path: Path) -> None:
    """SROS2 gives both ten years, from 2026 on here: that is no reason for a new authority, a flag day, in 2027."""
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    for days, code, found in ((0, 0, []), (1800, 0, []), (2200, 3, ["authority-due"])):
        clock = {"SOURCE_DATE_EPOCH": str(NOW + days * 86_400)}
        outcome = keymint("renew", "-w", "ws", "--json", env=clock)
        assert (outcome.code, outcome.codes()) == (code, found)
    begin = int(datetime(2026, 1, 1, tzinfo=UTC).timestamp())
    gauge = 'keymint_authority_renew_after_timestamp_seconds{authority="ca"}'
    assert (
        f"{gauge} {begin + 3650 * 86_400 * 66 // 100}" in keymint("status", "--format", "openmetrics", "-w", "ws").out
    )


def test_a_certificate_that_outlives_its_issuer_by_a_second_is_as_the_sources_ask(keymint, tmp_path: Path) -> None:
    """Both are made with the same number of days, one after the other: nothing would issue another one."""
    made(tmp_path / "ks", seconds_later=1)
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    assert "certificate-drift" not in keymint("check", "-w", "ws", "--json").codes()
    assert "nothing to do" in complete(keymint("install", "-w", "ws"))


def test_a_policy_in_comarmor(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("import", "policy.xml", "-o", "comarmor.d"))
    complete(keymint("adopt", "ks", "comarmor.d", "--apply", "-w", "ws"))
    assert "../comarmor.d" in (tmp_path / "ws/profile/policies.xml").read_text().replace("../../", "../")
    complete(keymint("install", "-w", "ws"))


def test_what_is_in_the_way_is_an_error_and_nothing_is_written(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks", domain=5, governance_domain=0)
    before = snapshot(keystore)
    for arguments in (["-w", "ws"], ["-w", "ks/ws"]):
        outcome = keymint("adopt", "ks", "policy.xml", "--apply", *arguments)
        assert outcome.code == 1
        assert "in domain 5, but the governance is for domain 0" in outcome.err
    assert not (tmp_path / "ws").exists()
    assert snapshot(keystore) == before


def test_a_workspace_is_not_overwritten_and_lies_beside_the_keystore(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ks")
    assert "the workspace would lie in the keystore" in outcome.err
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    before = snapshot(tmp_path / "ws")
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert (outcome.code, "there is a workspace already" in outcome.err) == (1, True)
    assert snapshot(tmp_path / "ws") == before


def test_a_dry_run_writes_nothing(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "--dry-run", "-w", "ws"))
    assert not (tmp_path / "ws").exists()


def test_a_changed_policy_replaces_only_what_it_changes(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    before = files(tmp_path / "ws/install")
    policy = tmp_path / "ws/profile/comarmor.d/policy.xml"
    policy.write_text(policy.read_text().replace("/chatter", "/chat", 1))
    for verb in (("create", "--all"), ("build",), ("install",)):
        complete(keymint(*verb, "-w", "ws"))
    after = files(tmp_path / "ws/install")
    assert {path for path in after if after[path] != before[path]} == {
        "enclaves/talker/permissions.p7s", "enclaves/talker/permissions.xml",
    }  # fmt: skip


def test_a_new_governance_replaces_links(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    governance = tmp_path / "ws/profile/package.defaults/governance.xml"
    governance.write_text(governance.read_text().replace("<rtps_protection_kind>SIGN", "<rtps_protection_kind>ENCRYPT"))
    complete(keymint("build", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))
    enclave = tmp_path / "ws/install/enclaves/talker"
    assert not (enclave / "governance.p7s").is_symlink()
    assert (enclave / "identity_ca.cert.pem").is_symlink()
    assert (enclave / "governance.p7s").read_bytes() == (tmp_path / "ws/install/enclaves/governance.p7s").read_bytes()
    assert keymint("check", "-w", "ws", "--json").document["exit_code"] in {0, 3}


def test_a_link_to_a_private_key_is_not_followed(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    link = tmp_path / "ws/install/enclaves/talker/identity_ca.cert.pem"
    link.unlink()
    link.symlink_to("../robot1/listener/key.pem")
    outcome = keymint("install", "-w", "ws")
    assert (outcome.code, "is a symbolic link" in outcome.err) == (1, True)


def test_a_new_key_replaces_the_certificate_and_the_permissions(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    before = files(tmp_path / "ws/install")
    complete(keymint("renew", "--rekey", "talker", "-w", "ws"))
    after = files(tmp_path / "ws/install")
    assert {path for path in before if after[path] != before[path]} == {
        "enclaves/talker/cert.pem", "enclaves/talker/key.pem", "enclaves/talker/permissions.p7s",
        "enclaves/talker/permissions.xml",
    }  # fmt: skip


def test_a_revoked_certificate_does_not_come_back(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    taken_over = files(tmp_path / "ws/install")["enclaves/talker/cert.pem"]
    assert keymint("revoke", "talker", "--reason", "superseded", "-w", "ws").code == 0
    revoked = files(tmp_path / "ws/install")
    assert revoked["enclaves/talker/cert.pem"] != taken_over
    complete(keymint("build", "-f", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))
    assert files(tmp_path / "ws/install") == revoked
    shutil.rmtree(tmp_path / "ws/.keymint")  # without the record everything is planned again
    complete(keymint("install", "-w", "ws"))
    assert files(tmp_path / "ws/install") == revoked


def test_files_of_openssl(keymint, tmp_path: Path) -> None:
    """RSA keys, a name of several parts, ranges of domains, and text around the certificate."""
    folder = tmp_path / "ks"
    folder.mkdir()

    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)

    for name, kind in (("id", "rsa:2048"), ("perm", "rsa:2048")):
        openssl("req", "-x509", "-newkey", kind, "-nodes", "-keyout", f"{name}.key", "-out", f"{name}.crt",
                "-subj", f"/O=Acme/CN={name}", "-days", "4000")  # fmt: skip
    openssl("req", "-newkey", "rsa:2048", "-nodes", "-keyout", "r.key", "-out", "r.csr", "-subj", "/O=Acme/CN=robot")
    openssl("x509", "-req", "-in", "r.csr", "-CA", "id.crt", "-CAkey", "id.key", "-set_serial", "7", "-days", "3000",
            "-text", "-out", "r.crt")  # fmt: skip
    (node,) = sros2_keystore.enclaves_of(POLICY.replace("/talker", "/robot"))["/robot"]
    document = sros2_keystore.permissions({"/robot": [node]}, ("2026-01-01T00:00:00Z", "2033-01-01T00:00:00"))
    (folder / "p.xml").write_bytes(document.replace(b"CN=/robot", b"CN=robot,O=Acme").replace(
        b"<id>0</id>", b"<id_range><min>0</min><max>9</max></id_range>"))  # fmt: skip
    governance = sros2_keystore.governance(0)
    (folder / "g.xml").write_bytes(governance.replace(b"<id>0</id>", b"<id_range><min>0</min><max>9</max></id_range>"))
    for name in "pg":
        openssl("smime", "-sign", "-text", "-in", f"{name}.xml", "-out", f"{name}.p7s", "-signer", "perm.crt",
                "-inkey", "perm.key")  # fmt: skip
    for key in folder.glob("*.key"):
        key.chmod(0o600)
    (folder / "r.csr").unlink()
    complete(keymint("adopt", "ks", "--apply", "-w", "ws"))
    after = files(tmp_path / "ws/install")
    for name, source in (("cert.pem", "r.crt"), ("permissions.p7s", "p.p7s"), ("governance.p7s", "g.p7s")):
        assert after[f"enclaves/robot/{name}"] == ("", (folder / source).read_bytes())
    complete(keymint("build", "-w", "ws"))
    complete(keymint("install", "-w", "ws"))
    assert files(tmp_path / "ws/install") == after
    assert "canonical" not in keymint("check", "-w", "ws").err
    complete(keymint("harden", "names", "--apply", "-w", "ws"))


def test_the_marker_of_a_package_is_written_last(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    document = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws", "--json").document
    written = [path for step in document["steps"] if step["stage"] == "adopt" for path in step["written"]]
    sources = [path for path in written if path.startswith("ws/src/talker/")]
    assert len(sources) > 3
    assert sources[-1] == "ws/src/talker/keymint_package.xml"


def test_a_second_name_of_an_authority_stays(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks", two=True)
    shutil.copyfile(keystore / "public/identity_ca.cert.pem", keystore / "public/former.cert.pem")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    complete(keymint("revoke", "talker", "--reason", "superseded", "-w", "ws"))
    assert (tmp_path / "ws/install/public/former.cert.pem").exists()


def test_an_edited_policy_is_noticed(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks")
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    assert keymint("build", "-w", "ws").err == ""
    new = tmp_path / "ws/profile/comarmor.d/policy.xml"
    new.write_text(new.read_text().replace("/talker/get_parameters", "/talker/other"))
    outcome = keymint("build", "-w", "ws", "--json")
    assert outcome.codes() == ["policy-changed"]
    complete(keymint("create", "--all", "-w", "ws"))
    assert keymint("build", "-w", "ws", "--json").codes() == []
    complete(keymint("install", "-w", "ws"))


@pytest.mark.parametrize("lost", ["talker", "robot1/listener"])
def test_an_enclave_that_is_installed_again_changes_no_other_one_behind_its_links(
    keymint, tmp_path: Path, lost: str
) -> None:
    """What it gets is signed again; the file that others have by links stays as they were given it."""
    made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    before = files(tmp_path / "ws/install")
    shutil.rmtree(tmp_path / "ws/install/enclaves" / lost)
    complete(keymint("install", "-w", "ws"))
    assert "file-changed" not in keymint("check", "-w", "ws", "--json").codes()
    after = files(tmp_path / "ws/install")
    assert {path for path in before if after.get(path) != before[path]} == {
        path for path in before if path.startswith(f"enclaves/{lost}/") and after.get(path) != before[path]
    }
    assert "nothing to do" in complete(keymint("install", "-w", "ws"))
