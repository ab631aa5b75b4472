# SPDX-License-Identifier: Apache-2.0
"""What the plan of an adoption refuses before anything is written."""

from __future__ import annotations

from pathlib import Path

from tests import sros2_keystore
from tests.keymint.commands.test_adopt import POLICY, made


def test_a_document_that_the_sources_cannot_mean(keymint, tmp_path: Path, monkeypatch) -> None:
    """A wrong comparison would be found by the build, which is planned before anything is written."""
    made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    monkeypatch.setattr("keymint_ros2_dds.kept_documents.not_kept", lambda *_: "it is something else")
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 1
    assert "cannot be kept as it is signed: it is something else" in outcome.err
    assert not (tmp_path / "ws").exists()


def test_a_file_that_the_installation_would_change(keymint, tmp_path: Path) -> None:
    """Outside of the enclaves lies the governance of another keystore, which nobody reads."""
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    (keystore / "enclaves/governance.xml").write_bytes(sros2_keystore.governance(9))
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 1
    assert "ks/enclaves/governance.xml: error: would be changed by 'keymint install'" in outcome.err
    assert not (tmp_path / "ws").exists()


def test_what_is_in_the_keystore_beside_it_stays_where_it_is(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    (keystore / "enclaves/notes.txt").write_text("mine")
    (keystore / "notes.txt").write_text("mine")
    (keystore / "enclaves/ca.key.pem").write_bytes((keystore / "private/ca.key.pem").read_bytes())
    (keystore / "enclaves/ca.key.pem").chmod(0o600)
    assert keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws").code == 0
    install = tmp_path / "ws/install"
    assert (install / "enclaves/notes.txt").read_text() == "mine"
    assert not (install / "notes.txt").exists()
    assert not (install / "enclaves/ca.key.pem").exists()  # a private key of an authority never reaches robots


def test_a_binary_file_that_only_its_owner_reads_stays_private(keymint, tmp_path: Path) -> None:
    """It may be a key in a form that is not PEM; certificates and documents are 0644 whatever their mode was."""
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    for name, mode in (("own.p12", 0o600), ("logo.png", 0o644)):
        (keystore / "enclaves" / name).write_bytes(b"\x30\x82\x00\xff")
        (keystore / "enclaves" / name).chmod(mode)
    (keystore / "enclaves/governance.xml").chmod(0o600)
    assert keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws").code == 0
    enclaves = tmp_path / "ws/install/enclaves"
    found = {name: (enclaves / name).stat().st_mode & 0o777 for name in ("own.p12", "logo.png", "governance.xml")}
    assert found == {"own.p12": 0o600, "logo.png": 0o644, "governance.xml": 0o644}
