# SPDX-License-Identifier: Apache-2.0
"""``keymint install``."""

from __future__ import annotations

import json
import re
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
                assert mode == (
                    0o600 if path.name.endswith(("key.pem", "register.sqlite3", "runs.jsonl")) else 0o644
                ), relative
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
    assert "error: a manual edit changes what /talker may do" in first
    assert discard in first
    assert outcome.err.count("error:") == 1, "one cause, one message"
    assert "signing the edited document" not in outcome.err
    assert snapshot(provisioned / "install") == before
    keymint(*discard.strip("'").split()[1:], cwd=provisioned)
    assert keymint("build", cwd=provisioned).code == 0
    assert keymint("install", cwd=provisioned).code == 0


def test_a_document_that_breaks_its_schema_is_not_signed(keymint, provisioned: Path) -> None:
    path = provisioned / "build/talker/permissions.xml"
    path.write_text(path.read_text().replace("<publish>", "<publsh>").replace("</publish>", "</publsh>"))
    before = snapshot(provisioned / "install")
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "build/talker/permissions.xml:" in outcome.err
    assert snapshot(provisioned / "install") == before


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


@pytest.mark.parametrize("kind", ["permissions", "governance"])
def test_a_document_that_cannot_be_signed_is_named_where_it_lies(keymint, provisioned: Path, kind: str) -> None:
    path = provisioned / f"build/talker/{kind}.xml"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    before = snapshot(provisioned / "install")
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    message = (
        "error: a document with a carriage return cannot be signed (save it with Unix line ends (LF)) [smime-content]"
    )
    assert outcome.err.splitlines()[0] == f"build/talker/{kind}.xml:1: {message}"
    assert snapshot(provisioned / "install") == before
