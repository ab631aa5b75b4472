"""``keymint install``."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import snapshot

ENCLAVE = {
    "identity_ca.cert.pem",
    "permissions_ca.cert.pem",
    "cert.pem",
    "key.pem",
    "governance.p7s",
    "permissions.p7s",
    "permissions.xml",
}


def test_the_layout_of_sros2(provisioned: Path) -> None:
    install = provisioned / "install"
    for enclave in ("talker", "robot1/listener"):
        assert {path.name for path in (install / "enclaves" / enclave).iterdir()} == ENCLAVE
    assert (install / "enclaves/governance.p7s").is_file()
    assert (install / "public/identity_ca.cert.pem").is_file()
    assert not (install / "private").exists()


def test_modes_whatever_the_umask(keymint, policy: Path, tmp_path: Path) -> None:
    for umask in (0o000, 0o077):
        # The command line sets its own umask, so this one is that of the shell that starts it.
        subprocess.run(
            ["sh", "-c", f"umask {umask:03o}; exec python3 -m keymint provision {policy} -w ws{umask}"],
            check=True,
            cwd=tmp_path,
            capture_output=True,
            env=_python_first(),
        )
        for path in (tmp_path / f"ws{umask}").rglob("*"):
            mode = path.stat().st_mode & 0o777
            relative = path.relative_to(tmp_path / f"ws{umask}")
            if path.is_file():
                assert mode == (0o600 if path.name.endswith("key.pem") else 0o644), relative
            elif relative.parts[0] == "private" or (path / "key.pem").exists():
                assert mode == 0o700, relative
            else:
                assert mode == 0o755, relative


def _python_first() -> dict[str, str]:
    import os
    import sys

    return os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}


def test_no_authoritys_private_key_is_staged(provisioned: Path) -> None:
    for name in ("identity_ca", "permissions_ca"):
        secret = (provisioned / f"private/{name}.key.pem").read_bytes().splitlines()[1]
        for path in (provisioned / "install").rglob("*"):
            assert path.is_dir() or secret not in path.read_bytes()


def test_an_enclave_can_be_copied_alone(provisioned: Path, tmp_path: Path) -> None:
    for path in (provisioned / "install").rglob("*"):
        assert not path.is_symlink()


def test_openssl_verifies_all_of_it(provisioned: Path) -> None:
    for enclave in ("talker", "robot1/listener"):
        folder = provisioned / "install/enclaves" / enclave
        for command in (
            "verify -attime 1800000000 -x509_strict -CAfile identity_ca.cert.pem cert.pem",
            "smime -verify -attime 1800000000 -text -in permissions.p7s -CAfile permissions_ca.cert.pem -out /dev/null",
            "smime -verify -attime 1800000000 -text -in governance.p7s -CAfile permissions_ca.cert.pem -out /dev/null",
            "pkey -in key.pem -check -noout",
        ):
            subprocess.run(["openssl", *command.split()], cwd=folder, check=True, capture_output=True)


def test_again_writes_nothing(keymint, provisioned: Path) -> None:
    before = snapshot(provisioned)
    outcome = keymint("install", cwd=provisioned)
    assert "nothing to do" in outcome.out
    assert snapshot(provisioned) == before


def test_nothing_is_signed_again_for_want_of_a_record(keymint, provisioned: Path) -> None:
    before = snapshot(provisioned / "install")
    (provisioned / ".keymint/state.json").unlink()
    assert keymint("build", cwd=provisioned).code == 0
    assert keymint("install", cwd=provisioned).code == 0
    assert snapshot(provisioned / "install") == before


def test_what_was_not_built(keymint, provisioned: Path, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("<attachment>/talker<", "<attachment>/speaker<"))
    keymint("create", "--all", cwd=provisioned)
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "the package speaker is not built (run 'keymint build speaker')" in outcome.err


def test_damage_is_repaired(keymint, provisioned: Path) -> None:
    enclave = provisioned / "install/enclaves/talker"
    before = {path.name: path.read_bytes() for path in enclave.iterdir()}
    (enclave / "permissions.p7s").write_bytes(before["permissions.p7s"][:-10])
    (enclave / "key.pem").chmod(0o644)
    assert keymint("install", cwd=provisioned).code == 0
    after = {path.name: path.read_bytes() for path in enclave.iterdir()}
    assert {name for name in before if before[name] != after[name]} == {"permissions.p7s"}
    assert (enclave / "key.pem").stat().st_mode & 0o777 == 0o600
    assert keymint("check", cwd=provisioned).code == 0


def test_a_document_edited_by_hand_is_signed_and_said(keymint, provisioned: Path) -> None:
    path = provisioned / "build/talker/permissions.xml"
    path.write_text(path.read_text().replace("rt/chatter", "rt/edited"))
    outcome = keymint("install", "--no-prove", cwd=provisioned)
    assert outcome.code == 0
    assert "build/talker/permissions.xml: warning: was edited by hand; signing the edited document" in outcome.err
    assert b"rt/edited" in (provisioned / "install/enclaves/talker/permissions.p7s").read_bytes()
    assert keymint("check", cwd=provisioned).code == 3


@pytest.mark.parametrize(
    ("file", "old", "new", "discard"),
    [
        ("build/talker/permissions.xml", "rt/chatter", "rt/edited", "'keymint build -f talker'"),
        ("src/talker/permissions.xml", "<attachment>/chatter<", "<attachment>/edited<", "'keymint create -f talker'"),
    ],
)
def test_an_edit_that_changes_the_meaning_is_refused_by_name(
    keymint, provisioned: Path, file: str, old: str, new: str, discard: str
) -> None:
    path = provisioned / file
    path.write_text(path.read_text().replace(old, new))
    assert keymint("build", cwd=provisioned).code == 0
    before = snapshot(provisioned / "install")
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 3
    first = next(line for line in outcome.err.splitlines() if line.startswith(file))
    assert "error: was edited by hand, and the edit changes what /talker may do" in first
    assert discard in first
    assert "signing the edited document" not in outcome.err
    assert snapshot(provisioned / "install") == before
    keymint(*discard.strip("'").split()[1:], cwd=provisioned)
    assert keymint("build", cwd=provisioned).code == 0
    assert keymint("install", cwd=provisioned).code == 0


def test_an_edit_that_keeps_the_meaning_is_signed_and_reported(keymint, provisioned: Path) -> None:
    path = provisioned / "build/talker/permissions.xml"
    path.write_text(path.read_text().replace('<grant name="/talker">', '<grant name="mine">'))
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 0
    assert "build/talker/permissions.xml: warning: was edited by hand; signing the edited document" in outcome.err
    assert b'"mine"' in (provisioned / "install/enclaves/talker/permissions.p7s").read_bytes()


def test_a_document_that_breaks_its_schema_is_not_signed(keymint, provisioned: Path) -> None:
    path = provisioned / "build/talker/permissions.xml"
    path.write_text(path.read_text().replace("<publish>", "<publsh>").replace("</publish>", "</publsh>"))
    before = snapshot(provisioned / "install")
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "build/talker/permissions.xml:" in outcome.err
    assert snapshot(provisioned / "install") == before


def test_nobody_is_told_to_create_what_is_as_the_policy_says(keymint, provisioned: Path, policy: Path) -> None:
    defaults = provisioned / "profile/package.defaults/permissions.xml"
    text = defaults.read_text()
    defaults.write_text(text.replace("<not_after>", "<!-- longer --><not_after>"))
    policy.write_text(f"{policy.read_text()}<!-- reviewed -->")
    copy = shutil.copytree(provisioned, provisioned.parent / "copy", symlinks=True)
    for workspace in (provisioned, copy):
        for words in (["build"], ["install"]):
            outcome = keymint(*words, cwd=workspace)
            assert (outcome.code, outcome.err) == (0, "")


def test_a_subject_that_the_policy_names_since_is_told(keymint, provisioned: Path, policy: Path) -> None:
    more = "<profile name='new'><attachment>/new</attachment></profile></profiles>"
    policy.write_text(policy.read_text().replace("</profiles>", more))
    outcome = keymint("build", cwd=provisioned)
    assert "1 source package out of date with the policy: /new (run 'keymint create --all')" in outcome.err
    policy.write_text("<profiles>")
    outcome = keymint("build", cwd=provisioned)
    assert "the policy changed since the packages were created, and cannot be read: " in outcome.err
    assert outcome.err.count("\n") == 1


def test_what_all_packages_owe_to_the_defaults_is_said_once(keymint, provisioned: Path) -> None:
    defaults = provisioned / "profile/package.defaults"
    identities = defaults / "identities.xml"
    identities.write_text(re.sub("<not_after>[^<]*", "<not_after>2070-01-01T00:00:00", identities.read_text()))
    governance = defaults / "governance.xml"
    governance.write_text(governance.read_text().replace("<topic_expression>*", "<topic_expression>x"))
    said = keymint("build", cwd=provisioned).err
    governance.write_text(governance.read_text().replace("SIGN<", "ENCRYPT<"))
    said += keymint("install", "--no-prove", cwd=provisioned).err
    lines = said.splitlines()
    for text in ("no topic rule matches every topic", "is cut to its issuer's", "is stale; signing the existing build"):
        (line,) = [line for line in lines if text in line]
        assert "[2 packages]" in line
    assert all("[2 packages]" in line for line in lines)
    assert "package.defaults/governance.xml:18: warning: no topic rule" in said
    assert "package.defaults/identities.xml:10: warning: the validity of the certificate" in said


def test_an_open_governance_of_all_is_refused_once_at_the_unsigned_document(keymint, provisioned: Path) -> None:
    governance = provisioned / "profile/package.defaults/governance.xml"
    governance.write_text(governance.read_text().replace("write_access_control>true", "write_access_control>false"))
    keymint("build", cwd=provisioned)
    outcome = keymint("install", "--json", cwd=provisioned)
    assert outcome.code == 3
    (found,) = [each for each in json.loads(outcome.out)["diagnostics"] if each["code"] == "counterexample"]
    assert "[2 packages]" in found["message"]
    assert found["file"] == "build/robot1/listener/governance.xml"
    lines = (provisioned / found["file"]).read_text().splitlines()
    assert "<topic_rule>" in lines[found["line"] - 1]
    assert f"{found['file']}:{found['line']}: enable_write_access_control is false" in found["message"]


def test_sources_and_policy_that_changed_are_said(keymint, provisioned: Path, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("/chatter", "/other"))
    for words in (["build"], ["install"], ["install", "--no-prove"]):
        outcome = keymint(*words, cwd=provisioned)
        message = "2 source packages out of date with the policy: /robot1/listener, /talker"
        assert f"{message} (run 'keymint create --all')" in outcome.err
    keymint("create", "--all", cwd=provisioned)
    outcome = keymint("install", "--no-prove", cwd=provisioned)
    assert "build/robot1/listener: warning: is stale; signing the existing build [2 packages]" in outcome.err
    keymint("build", cwd=provisioned)
    outcome = keymint("install", cwd=provisioned)
    assert (outcome.code, outcome.err) == (0, "")


def test_an_enclave_that_is_a_link_is_refused(keymint, provisioned: Path, tmp_path: Path) -> None:
    folder = provisioned / "install/enclaves/talker"
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "install/enclaves/talker: error: is a symbolic link" in outcome.err


class TestPrune:
    def remove(self, ws: Path) -> None:
        for path in (ws / "src/talker").iterdir():
            path.unlink()
        (ws / "src/talker").rmdir()

    def test_an_enclave_without_a_package_is_reported(self, keymint, provisioned: Path) -> None:
        self.remove(provisioned)
        assert "orphaned" in keymint("status", cwd=provisioned).out
        outcome = keymint("install", cwd=provisioned)
        assert "the enclave /talker is installed, but has no source package" in outcome.err
        assert (provisioned / "install/enclaves/talker/key.pem").is_file()

    def test_and_removed_on_request(self, keymint, provisioned: Path) -> None:
        self.remove(provisioned)
        assert keymint("install", "--prune", cwd=provisioned).code == 0
        assert not (provisioned / "install/enclaves/talker").exists()
        assert (provisioned / "install/enclaves/robot1/listener/key.pem").is_file()
        assert keymint("check", cwd=provisioned).code == 0

    def test_enclaves_inside_of_it_stay(self, keymint, tmp_path: Path) -> None:
        (tmp_path / "p.xml").write_text(
            "<profiles><profile name='a'><attachments><attachment>/robot</attachment>"
            "<attachment>/robot/arm</attachment></attachments></profile></profiles>"
        )
        assert keymint("provision", "p.xml", "-w", "ws").code == 0
        ws = tmp_path / "ws"
        for path in (ws / "src/robot").glob("*.xml"):
            path.unlink()
        assert keymint("install", "--prune", cwd=ws).code == 0
        assert not (ws / "install/enclaves/robot/key.pem").exists()
        assert (ws / "install/enclaves/robot/arm/key.pem").is_file()


class TestFlatLayout:
    def test_of_ardent(self, keymint, policy: Path, tmp_path: Path) -> None:
        assert keymint("provision", policy, "-w", "ws", "--layout", "flat").code == 0
        folder = tmp_path / "ws/install/talker"
        assert {path.name for path in folder.iterdir()} == {
            "ca.cert.pem",
            "cert.pem",
            "key.pem",
            "governance.p7s",
            "permissions.p7s",
        }
        outcome = keymint("check", "-w", "ws", "--json")
        assert {d["severity"] for d in outcome.document["diagnostics"]} <= {"warning", "note"}


class TestAuthorities:
    """Other authorities than the default ones."""

    def profile(self, ws: Path, authorities: str) -> None:
        (ws / "profile/authorities.xml").write_text(
            f"<?xml version='1.0'?>\n<profile>\n<authorities>\n{authorities}\n</authorities>\n</profile>\n"
        )

    @pytest.fixture
    def ws(self, keymint, policy: Path, tmp_path: Path) -> Path:
        assert keymint("init", "ws", "--policy", policy).code == 0
        return tmp_path / "ws"

    def stages(self, keymint, ws: Path, env=None):
        for arguments in (("create", "--all"), ("build",)):
            assert keymint(*arguments, cwd=ws, env=env).code == 0
        return keymint("install", cwd=ws, env=env)

    def test_an_encrypted_key_takes_its_password_from_the_environment(self, keymint, ws: Path) -> None:
        for path in [*(ws / "private").glob("*.pem"), *(ws / "public").glob("*.pem")]:
            path.unlink()
        defaults = ws / "profile/profile.defaults/authorities.xml"
        text = defaults.read_text()
        assert "<encryption_algorithm>NoEncryption</encryption_algorithm>" in text
        encrypted = (
            text.replace("NoEncryption", "BestAvailableEncryption")
            .replace("<password_env></password_env>", "<password_env>CA_PASSWORD</password_env>")
            .replace("<password_env/>", "<password_env>CA_PASSWORD</password_env>")
        )
        if "CA_PASSWORD" not in encrypted:
            encrypted = encrypted.replace(
                "</encryption_algorithm>", "</encryption_algorithm>\n    <password_env>CA_PASSWORD</password_env>"
            )
        defaults.write_text(encrypted)
        for arguments in (("create", "--all"), ("build",)):
            assert keymint(*arguments, cwd=ws).code == 0
        outcome = keymint("install", cwd=ws)
        assert outcome.code == 1
        assert "the environment variable CA_PASSWORD, which holds the key's password, is not set" in outcome.err
        assert keymint("install", cwd=ws, env={"CA_PASSWORD": "correct horse"}).code == 0
        assert b"ENCRYPTED" in (ws / "private/identity_ca.key.pem").read_bytes()
        assert keymint("install", cwd=ws).code == 0  # nothing is to be signed, so no password is needed
        wrong = keymint("build", "-f", cwd=ws, env={"CA_PASSWORD": "battery staple"})
        assert wrong.code == 0  # building needs no authority
        wrong = keymint("install", cwd=ws, env={"CA_PASSWORD": "battery staple"})
        assert wrong.code == 1
        assert "battery" not in wrong.err + wrong.out
        assert "private/identity_ca.key.pem" in wrong.err

    def test_what_one_vendor_refuses_of_it_is_said_once(self, keymint, ws: Path) -> None:
        """Measured with participants: an intermediate authority, its key, and the hash of the identity."""
        self.profile(
            ws,
            '<authority name="root"><cert><serial_number/><issuer_name/></cert></authority>'
            '<authority name="identity_ca"><cert><serial_number/><issuer_name>root</issuer_name></cert></authority>'
            '<authority name="permissions_ca"><cert><serial_number/><issuer_name/></cert></authority>',
        )
        for file in ("profile.defaults/authorities.xml", "package.defaults/identities.xml"):
            path = ws / "profile" / file
            text = path.read_text()
            path.write_text(
                text.replace("SECP256R1", "SECP384R1") if "authorities" in file else text.replace("SHA256", "SHA384")
            )
        for path in (ws / "private").glob("*.key.pem"):
            path.unlink()
            (ws / "public" / path.name.replace(".key.", ".cert.")).unlink()
        assert keymint("create", "--all", cwd=ws).code == 0
        outcome = keymint("build", "--json", cwd=ws)
        assert outcome.code == 0
        codes = sorted(code for code in outcome.codes() if code.startswith("portability"))
        # The hash is said at each package's identity; the authorities once for all packages.
        assert codes.count("portability-chain") == 1
        assert codes.count("portability-authority-key") == 2
        assert "portability-hash" in codes
        assert all(found["severity"] == "warning" for found in outcome.document["diagnostics"])

    def test_a_hierarchy_verifies_up_to_its_root(self, keymint, ws: Path) -> None:
        self.profile(
            ws,
            '<authority name="root"><cert><serial_number/><issuer_name/></cert></authority>'
            '<authority name="identity_ca"><cert><serial_number/><issuer_name>root</issuer_name></cert></authority>'
            '<authority name="permissions_ca"><cert><serial_number/><issuer_name/></cert></authority>',
        )
        outcome = self.stages(keymint, ws)
        assert outcome.code == 0, outcome.err
        enclave = ws / "install/enclaves/talker"
        done = subprocess.run(
            [
                "openssl",
                "verify",
                "-attime",
                "1800000000",
                "-x509_strict",
                "-CAfile",
                ws / "public/root.cert.pem",
                "-untrusted",
                enclave / "identity_ca.cert.pem",
                enclave / "cert.pem",
            ],
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        outcome = keymint("check", cwd=ws)
        assert "error" not in outcome.err


def with_a_root(ws: Path) -> None:
    """Have the identities' authority issued by a third one."""
    path = ws / "profile/authorities.xml"
    path.write_text(
        path.read_text()
        .replace("<authorities>", '<authorities><authority name="root"><cert><issuer_name/></cert></authority>')
        .replace("<issuer_name></issuer_name>", "<issuer_name>root</issuer_name>", 1)
    )


def test_an_authoritys_private_key_may_be_kept_elsewhere(keymint, provisioned: Path) -> None:
    with_a_root(provisioned)
    assert keymint("install", cwd=provisioned).code == 0
    (provisioned / "private/root.key.pem").unlink()
    before = snapshot(provisioned)
    assert keymint("install", cwd=provisioned).out.startswith("nothing to do")
    assert keymint("check", cwd=provisioned).code == 0
    assert keymint("build", "--renew", "talker", cwd=provisioned).code == 0
    assert keymint("install", cwd=provisioned).code == 0  # the intermediate authority issues
    after = snapshot(provisioned)
    assert {path: after[path] for path in after if path.startswith("public/")} == {
        path: before[path] for path in before if path.startswith("public/")
    }


@pytest.mark.parametrize("name", ["permissions_ca", "identity_ca", "root"])
def test_an_authority_is_not_replaced_because_its_key_is_not_here(keymint, provisioned: Path, name: str) -> None:
    with_a_root(provisioned)
    assert keymint("install", cwd=provisioned).code == 0
    (provisioned / f"private/{name}.key.pem").unlink()
    for part in ("identities", "permissions", "governance"):  # so that everything is to be signed anew
        path = provisioned / f"profile/package.defaults/{part}.xml"
        path.write_text(
            path.read_text().replace("<not_after>2028-01-14", "<not_after>2028-01-10").replace(">SIGN<", ">ENCRYPT<")
        )
    path = provisioned / "profile/profile.defaults/authorities.xml"
    path.write_text(path.read_text().replace("<hash_algorithm>SHA256", "<hash_algorithm>SHA512"))
    assert keymint("build", cwd=provisioned).code == 0
    before = snapshot(provisioned)
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert f"the private key of the authority '{name}' is not here" in outcome.err
    assert snapshot(provisioned) == before
    (provisioned / f"public/{name}.cert.pem").unlink()
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "has neither key nor certificate here, but enclaves that are installed trust it" in outcome.err
    assert keymint("install", "--new-authority", name, cwd=provisioned).code == 0
