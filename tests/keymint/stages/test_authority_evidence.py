# SPDX-License-Identifier: Apache-2.0
"""Proofs rest on the authorities in ``public/``; other evidence in the workspace may speak against these files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

PUBLIC = ("public/identity_ca.cert.pem", "public/permissions_ca.cert.pem")
PRIVATE = ("private/identity_ca.key.pem", "private/permissions_ca.key.pem")
BLOCKS = {
    "a second certificate": lambda foreign: foreign,
    "a block that OpenSSL reads as a certificate": lambda foreign: foreign.replace(b"CERT", b"TRUSTED CERT"),
    "a revocation list, which Fast DDS reads": lambda foreign: foreign.replace(b"CERTIFICATE", b"X509 CRL"),
}


def everywhere(ws: Path, name: str, change: Callable[[bytes], bytes]) -> None:
    """Change a certificate in the workspace, and in every enclave alike."""
    for path in (ws / "public" / name, *ws.glob(f"install/enclaves/**/{name}")):
        path.write_bytes(change(path.read_bytes()))


def asked(keymint: Callable, ws: Path) -> dict[str, tuple[int, set[str]]]:
    """Return the exit code and the codes of the findings of each verb that rests on the authorities."""
    verbs = {
        "prove": ("prove",),
        "verify": ("verify", "-i", "fastdds-2.9"),
        "why": ("why", "/talker", "ros_publish", "/chatter", "-i", "fastdds-2.9"),
    }
    outcomes = {verb: keymint(*words, "--json", cwd=ws) for verb, words in verbs.items()}
    return {verb: (outcome.code, set(outcome.codes())) for verb, outcome in outcomes.items()}


@pytest.mark.parametrize("what", BLOCKS)
@pytest.mark.parametrize("role", ["identity_ca", "permissions_ca"])
def test_who_is_added_to_an_authority_everywhere_is_found(keymint, made: Path, ws: Path, role: str, what: str) -> None:
    """Fast DDS lets in whom any certificate of the identity authority's file has issued."""
    name = f"{role}.cert.pem"
    added = BLOCKS[what]((made / "foreign/public" / name).read_bytes())
    everywhere(ws, name, lambda own: own + added)
    for verb, (code, codes) in asked(keymint, ws).items():
        assert (verb, code) == (verb, 3)
        assert codes & {"certificate-invalid", "certificate-ambiguous"}, (verb, codes)


@pytest.mark.parametrize("offline", [False, True])
@pytest.mark.parametrize("recorded", [False, True])
def test_a_workspace_that_rests_on_a_strangers_authorities(
    keymint, made: Path, ws: Path, recorded: bool, offline: bool
) -> None:
    """Everything public is a stranger's, and fits together. The keys and the record are the owner's."""
    assert keymint("prove", cwd=ws).code == 0
    for folder in ("public", "install"):
        shutil.rmtree(ws / folder)
        shutil.copytree(made / "foreign" / folder, ws / folder)
    if offline:
        for name in PRIVATE:
            (ws / name).unlink()
    if not recorded:
        (ws / ".keymint/state.json").unlink()
    codes = {"authority-replaced"} if offline else {"authority-key-mismatch"}
    expected = dict.fromkeys(("prove", "verify", "why"), (3, codes))
    if offline and not recorded:  # only the register is left, which has none of the certificates
        expected = {"prove": (3, {"certificate-unregistered"}), "verify": (0, set()), "why": (0, set())}
    ours = {"authority-replaced", "authority-key-mismatch", "certificate-unregistered"}
    for verb, (code, found) in asked(keymint, ws).items():
        of_authorities, wanted = found & ours, expected[verb]
        assert (verb, code) == (verb, wanted[0])
        assert of_authorities >= wanted[1]


def test_what_speaks_against_an_authority_is_said_once(keymint, made: Path, ws: Path) -> None:
    shutil.copyfile(made / "foreign" / PUBLIC[0], ws / PUBLIC[0])
    said = keymint("prove", cwd=ws).err
    assert said.count("public/identity_ca.cert.pem: error:") == 1, said


def test_authorities_whose_keys_are_elsewhere_or_encrypted_are_rested_on(keymint, ws: Path) -> None:
    for name in PRIVATE:
        (ws / name).unlink()
    assert {code for code, _ in asked(keymint, ws).values()} == {0}


def test_text_around_a_certificate_is_no_doubt(keymint, ws: Path) -> None:
    """As ``openssl x509 -text`` writes it."""
    for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
        everywhere(ws, name, lambda own: b"Certificate:\n    Data:\n        Version: 3 (0x2)\n" + own)
    assert asked(keymint, ws)["prove"][0] == 0


@pytest.mark.parametrize("name", ["permissions_ca.cert.p11", "identity_ca.cert.p11", "ca.cert.pem", "permissions.p7s"])
def test_a_link_is_read_by_ros_2_and_not_here(keymint, ws: Path, name: str) -> None:
    """``std::filesystem::is_regular_file`` follows links; what the enclave trusts then lies elsewhere."""
    target = ws / "elsewhere"
    path = ws / "install/enclaves/talker" / name
    if path.exists():
        path.rename(target)
    else:
        target.write_text("pkcs11:object=other;type=cert")
    path.symlink_to(target)
    for verb, (code, codes) in asked(keymint, ws).items():
        assert (verb, code, "symlink-refused" in codes) == (verb, 3, True)
