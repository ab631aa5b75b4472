# SPDX-License-Identifier: Apache-2.0
"""``keymint adopt``: what it says about keystores of other tools."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
)

from keymint.pki import keys
from tests import sros2_keystore
from tests.signers import by_sros2
from tests.sros2_keystore import Form

POLICY = """<policy version="0.2.0"><enclaves>
  <enclave path="/talker"><profiles><profile ns="/" node="talker">
    <topics publish="ALLOW"><topic>chatter</topic></topics>
    <services reply="ALLOW"><service>~/get_parameters</service></services>
  </profile></profiles></enclave>
  <enclave path="/robot1/listener"><profiles><profile ns="/robot1" node="listener">
    <topics subscribe="ALLOW"><topic>/chatter</topic></topics>
  </profile></profiles></enclave>
</enclaves></policy>"""
TALKER = "ks/enclaves/talker"


@pytest.fixture
def keystore(tmp_path: Path) -> Path:
    """A keystore in the form of ``ros2 security``, whose keys nobody else can read."""
    return made(tmp_path / "ks")


def made(root: Path, **form: object) -> Path:
    sros2_keystore.make(root, POLICY, Form(**form))
    for path in root.rglob("*.pem"):
        path.chmod(0o600 if "key" in path.name else 0o644)
    return root


def snapshot(folder: Path) -> Mapping[str, tuple[str, int, bytes]]:
    """Return everything below a folder: kind or link, mode, content."""
    found = {}
    for path in sorted(folder.rglob("*")):
        link = str(path.readlink()) if path.is_symlink() else ""
        content = b"" if link or path.is_dir() else path.read_bytes()
        found[str(path.relative_to(folder))] = (link, path.lstat().st_mode, content)
    return found


def codes(outcome) -> list[tuple[str, str]]:
    return sorted({(each["severity"], each["code"]) for each in outcome.document["diagnostics"]})


def test_a_sound_keystore(keymint, keystore: Path, tmp_path: Path) -> None:
    before = snapshot(tmp_path)
    outcome = keymint("adopt", "ks")
    assert outcome.code == 0
    listener, talker = outcome.err.splitlines()
    assert listener.startswith("ks/enclaves/robot1/listener/permissions.p7s: note: /robot1/listener: a node of this")
    assert talker.startswith(f"{TALKER}/permissions.p7s: note: /talker: a node of this subject cannot start on Jazzy")
    assert "serve any …/get_type_description" in talker
    assert outcome.out.splitlines()[0] == "ks: 2 enclaves, made like 'ros2 security' of Foxy and later"
    assert "authority  ca  CN=sros2CA, for identity and permissions, SECP256R1, until " in outcome.out
    assert "enclave    /talker  CN=/talker; until " in outcome.out
    assert "right: chain, key, name, signatures, text" in outcome.out
    assert "WRONG" not in outcome.out
    assert snapshot(tmp_path) == before  # not even a lock


def test_a_name_that_has_two_common_names_is_confused_by_newer_vendors(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks", common_names={"/talker": "/other+/talker"})
    found = [
        each for each in keymint("adopt", "ks", "--json").document["diagnostics"] if each["code"] == "names-confused"
    ]
    assert [each["severity"] for each in found] == ["warning"]
    assert "has CN twice in its name 'CN=/other,CN=/talker'" in found[0]["message"]


@pytest.mark.parametrize(
    ("flag", "said"),
    [
        ("allow_unauthenticated_participants", "participants without identity and permissions may join domain 0"),
        ("enable_join_access_control", "every identity of the authority may join domain 0"),
    ],
)
def test_a_governance_that_lets_anyone_join_is_said_before_it_is_taken_over(
    keymint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flag: str, said: str
) -> None:
    opposite = {"true": "false", "false": "true"}
    rules = tuple((tag, opposite[text] if tag == flag else text) for tag, text in sros2_keystore._DOMAIN_RULE)
    monkeypatch.setattr(sros2_keystore, "_DOMAIN_RULE", rules)
    made(tmp_path / "ks")
    outcome = keymint("adopt", "ks", "--json")
    found = [each for each in outcome.document["diagnostics"] if each["code"] == "governance-open-join"]
    assert [each["subject"] for each in found] == ["/robot1/listener", "/talker"]
    assert all(said in each["message"] and each["severity"] == "warning" for each in found)
    assert outcome.code == 3


def test_json(keymint, keystore: Path) -> None:
    outcome = keymint("adopt", "ks", "--json")
    result = outcome.document["result"]
    assert codes(outcome) == [
        ("note", "adopt-extensions"), ("note", "adopt-one-authority"), ("note", "node-cannot-start"),
    ]  # fmt: skip
    (authority,) = result["authorities"]
    assert (authority["name"], authority["roles"], authority["path_length"]) == ("ca", ["identity", "permissions"], 1)
    assert (authority["key_usage"], authority["subject_key_identifier"]) == (None, False)
    talker = result["enclaves"][1]
    assert talker["subject"] == "/talker"
    assert talker["domains"] == talker["governance_domains"] == [[0, 0]]
    assert talker["signatures"] == {"permissions": True, "governance": True}
    assert (talker["links"], talker["key"], talker["modes"]["key.pem"]) == (3, "matches", "0600")
    assert "PRIVATE" not in outcome.out


@pytest.mark.parametrize(
    ("form", "words"),
    [
        ({"layout": "flat", "period": ("2020-01-01T00:00:00", "2090-01-01T00:00:00")}, "before Foxy"),
        ({"layout": "rti"}, "single files"),
        ({"two": True, "domain": 7}, "of Foxy and later"),
    ],
)
def test_other_forms(keymint, tmp_path: Path, form: Mapping[str, object], words: str) -> None:
    made(tmp_path / "ks", **form)
    outcome = keymint("adopt", "ks")
    assert outcome.code == 0
    assert all("note: /" in line and "cannot start on Jazzy" in line for line in outcome.err.splitlines())
    assert bool(outcome.err) == (form.get("layout") != "flat")  # what nodes before Foxy ask for was not measured
    assert words in outcome.out.splitlines()[0]
    assert outcome.out.count("right: chain, key, name, signatures") == 2


def test_a_keystore_of_keymint(keymint, policy: Path) -> None:
    assert keymint("provision", policy, "-w", "ws").code == 0
    outcome = keymint("adopt", "ws/install")
    assert (outcome.code, outcome.err) == (0, "")
    assert "key elsewhere" in outcome.out


def test_the_hint_about_an_authority_that_expired_names_it(keymint, tmp_path: Path) -> None:
    made(tmp_path / "ks", now=datetime(2020, 1, 1, tzinfo=UTC), days=10)
    found = keymint("adopt", "ks", "--json").document["diagnostics"]
    (help_,) = {each["help"] for each in found if each["code"] == "adopt-authority-expired"}
    assert help_ == "'keymint authority renew ca' afterwards"


def test_keys_that_others_could_read(keymint, keystore: Path) -> None:
    (keystore / "private/ca.key.pem").chmod(0o644)
    (keystore / "enclaves/talker/key.pem").chmod(0o640)
    outcome = keymint("adopt", "ks")
    assert outcome.code == 3
    assert "ks/private/ca.key.pem: warning: is a private key with mode 0644" in outcome.err
    assert f"{TALKER}/key.pem: warning: is a private key with mode 0640" in outcome.err
    assert "'keymint renew --rekey talker', then 'keymint revoke talker --reason superseded', if" in outcome.err


def _replace(path: str, content: bytes) -> Callable[[Path], None]:
    return lambda root: (root / path).write_bytes(content)


def _swap(one: str, other: str) -> Callable[[Path], None]:
    def swap(root: Path) -> None:
        content = (root / one).read_bytes()
        (root / one).write_bytes((root / other).read_bytes())
        (root / other).write_bytes(content)

    return swap


def _append(path: str, content: bytes) -> Callable[[Path], None]:
    return lambda root: (root / path).write_bytes((root / path).read_bytes() + content)


def _alter(path: str, old: bytes, new: bytes) -> Callable[[Path], None]:
    def alter(root: Path) -> None:
        before = (root / path).read_bytes()
        assert old in before
        (root / path).write_bytes(before.replace(old, new))

    return alter


ENCLAVE, OTHER = "enclaves/talker", "enclaves/robot1/listener"
DEFECTS: Mapping[str, tuple[Callable[[Path], object], str, str]] = {
    "no certificate": (lambda root: (root / ENCLAVE / "cert.pem").unlink(), "adopt-file-missing", "cert.pem: error"),
    "no permissions": (lambda root: (root / ENCLAVE / "permissions.p7s").unlink(), "adopt-file-missing", "missing"),
    "damaged certificate": (_replace(f"{ENCLAVE}/cert.pem", b"x"), "certificate-invalid", "cert.pem: error"),
    "empty certificate": (_replace(f"{ENCLAVE}/cert.pem", b""), "certificate-invalid", "cert.pem: error"),
    "another key": (_swap(f"{ENCLAVE}/key.pem", f"{OTHER}/key.pem"), "adopt-key-mismatch", "key.pem: error"),
    "damaged key": (_replace(f"{ENCLAVE}/key.pem", b"-----BEGIN PRIVATE KEY-----\n"), "key-invalid", "key.pem: error"),
    "altered permissions": (_alter(f"{ENCLAVE}/permissions.p7s", b"rt/chatter", b"rt/chattel"), "smime-altered", "p7s"),
    "another text": (_append(f"{ENCLAVE}/permissions.xml", b"\n"), "adopt-document-differs", "permissions.xml: error"),
    "permissions of another": (
        _swap(f"{ENCLAVE}/permissions.p7s", f"{OTHER}/permissions.p7s"), "adopt-grant-subject",
        "grants to 'CN=/robot1/listener', but the certificate is for 'CN=/talker'",
    ),
    "a token": (_replace(f"{ENCLAVE}/key.p11", b"pkcs11:token=x"), "adopt-token", "key.p11: error"),
    "a certificate in a token": (_replace(f"{ENCLAVE}/cert.p11", b"pkcs11:x"), "adopt-token", "replaces cert.pem in"),
    "text around an authority": (_append("public/ca.cert.pem", b"my CA\n"), "adopt-encoding", "openssl x509"),
}  # fmt: skip


@pytest.mark.parametrize("defect", DEFECTS)
def test_defects(keymint, keystore: Path, defect: str) -> None:
    damage, code, words = DEFECTS[defect]
    damage(keystore)
    outcome = keymint("adopt", "ks")
    assert outcome.code == 3
    assert words in outcome.err
    assert ("error", code) in codes(keymint("adopt", "ks", "--json"))


def test_a_key_elsewhere_is_no_finding(keymint, keystore: Path) -> None:
    (keystore / "enclaves/talker/key.pem").unlink()
    shutil.rmtree(keystore / "private")
    outcome = keymint("adopt", "ks", "--json")
    assert outcome.code == 0
    notes = {each["code"] for each in outcome.document["diagnostics"]}
    assert {"adopt-key-elsewhere", "adopt-authority-elsewhere"} <= notes
    assert [each["key"] for each in outcome.document["result"]["enclaves"]] == ["matches", "elsewhere"]


@pytest.mark.parametrize(
    ("form", "code", "words"),
    [
        ({"common_names": {"/talker": "/" + "x" * 70}}, "adopt-name-length", "has a common name of 71 characters"),
        ({"common_names": {"/talker": "other"}}, "adopt-name", "the path of its enclave is /talker"),
        ({"domain": 5, "governance_domain": 0}, "adopt-domain", "in domain 5, but the governance is for domain 0"),
        ({"period": ("2013-10-26T00:00:00", "2023-10-26T22:45:30")}, "adopt-grant-expired", "2023-10-26"),
        ({"period": ("yesterday", "tomorrow")}, "adopt-grant-dates", "'yesterday'"),
        ({"now": datetime(2020, 1, 1, tzinfo=UTC), "days": 10}, "certificate-expired", "2020-01-11"),
    ],
)  # fmt: skip
def test_odd_keystores(keymint, tmp_path: Path, form: Mapping[str, object], code: str, words: str) -> None:
    made(tmp_path / "ks", **form)
    outcome = keymint("adopt", "ks")
    assert outcome.code == 3
    assert words in outcome.err
    assert code in {found for _, found in codes(keymint("adopt", "ks", "--json"))}


def test_permissions_that_allow_everything(keymint, tmp_path: Path) -> None:
    everything = POLICY.replace("<topic>chatter</topic>", "<topic>/*</topic>")
    sros2_keystore.make(tmp_path / "ks", everything, Form())
    assert "allows all of a kind of topics: publish rt/*" in keymint("adopt", "ks").err


def test_the_root_enclave_needs_a_second_rdn(keymint, tmp_path: Path) -> None:
    sros2_keystore.make(tmp_path / "ks", POLICY.replace('path="/talker"', 'path="/"'), Form())
    outcome = keymint("adopt", "ks")
    assert "ks/enclaves/cert.pem: warning: is the root enclave with the name 'CN=/' alone" in outcome.err
    assert "enclave    /  CN=/; " in outcome.out


def test_a_path_that_is_no_name_of_a_subject(keymint, tmp_path: Path) -> None:
    sros2_keystore.make(tmp_path / "ks", POLICY.replace("/talker", "/my-talker"), Form())
    outcome = keymint("adopt", "ks")
    assert "ks/enclaves/my-talker: error: '/my-talker' is not a legal name" in outcome.err


def test_two_grants(keymint, tmp_path: Path) -> None:
    one = (
        '<profiles><profile ns="/" node="x"><topics publish="ALLOW"><topic>other</topic></topics></profile></profiles>'
    )
    sros2_keystore.make(tmp_path / "ks", POLICY.replace("</enclave>", f"{one}</enclave>", 1), Form())
    assert "permissions.p7s: error: has 2 grants" in keymint("adopt", "ks").err


@pytest.mark.parametrize(
    "content", [b"", b"<dds>", b"<a/>", b"<!DOCTYPE dds><dds/>", b"<dds><domain_access_rules/></dds>"]
)
@pytest.mark.parametrize("name", ["talker/permissions.p7s", "governance.p7s"])
def test_what_is_signed_and_no_document_is_a_finding_like_others(
    keymint, keystore: Path, name: str, content: bytes
) -> None:
    authority = x509.load_pem_x509_certificate((keystore / "public/ca.cert.pem").read_bytes())
    key = keys.from_pem((keystore / "private/ca.key.pem").read_bytes())
    (keystore / "enclaves" / name).write_bytes(by_sros2(content, authority, key))
    (keystore / "private/ca.key.pem").chmod(0o644)
    outcome = keymint("adopt", "ks", "--json")
    assert outcome.code == 3
    found = {each["file"] for each in outcome.document["diagnostics"] if each["severity"] == "error"}
    assert any(each.endswith(name.rpartition("/")[2]) for each in found)
    assert "adopt-key-exposed" in outcome.codes()


def test_places_in_a_document_are_those_of_its_own_signature(keymint, keystore: Path) -> None:
    """openssl puts other lines before a document than SROS2 does."""
    authority = x509.load_pem_x509_certificate((keystore / "public/ca.cert.pem").read_bytes())
    key = keys.from_pem((keystore / "private/ca.key.pem").read_bytes())
    governance = keystore / "enclaves/governance.p7s"
    governance.write_bytes(
        governance.read_bytes().replace(b"MIME-Version: 1.0\n", b"MIME-Version: 1.0\nSubject: a\nTo: b\n", 1)
    )
    signed = by_sros2(b"<dds>\n<permissions/>\n<oops>\n</dds>", authority, key)
    (keystore / "enclaves/talker/permissions.p7s").write_bytes(signed)
    line = signed.decode().splitlines().index("</dds>") + 1
    assert f"{TALKER}/permissions.p7s:{line}: error: not well-formed XML" in keymint("adopt", "ks").err


def test_no_link_leads_out_of_the_keystore(keymint, keystore: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.pem").write_bytes((keystore / "enclaves/talker/cert.pem").read_bytes())
    cases = {"absolute": tmp_path / "secret.pem", "upward": Path("../../../secret.pem"), "missing": Path("nothing.pem")}
    for target in cases.values():
        path = keystore / "enclaves/talker/cert.pem"
        path.unlink()
        path.symlink_to(target)
        outcome = keymint("adopt", "ks")
        assert outcome.code == 3
        assert f"{TALKER}/cert.pem: error: is a link to" in outcome.err
        assert f"{target.name}', which is not" in outcome.err


def test_a_folder_behind_a_link_is_not_entered(keymint, keystore: Path, tmp_path: Path) -> None:
    shutil.move(keystore / "enclaves/robot1", tmp_path / "robot1")
    (keystore / "enclaves/robot1").symlink_to(tmp_path / "robot1")
    outcome = keymint("adopt", "ks")
    assert "1 enclave," in outcome.out
    assert "ks/enclaves/robot1: error: is a link to" in outcome.err


@pytest.mark.parametrize(
    ("name", "words"), [("nothing", "no such folder"), ("empty", "has no enclave"), ("file", "is not a folder")]
)
def test_no_keystore(keymint, tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    outcome = keymint("adopt", name)
    assert outcome.code == 1
    assert outcome.err.startswith(f"{name}: error: {words}")


@pytest.mark.parametrize("verb", [["init", "ks"], ["init", "-w", "ks"], ["provision", "policy.xml", "-w", "ks"]])
def test_a_keystore_is_no_place_for_a_new_workspace(keymint, keystore: Path, tmp_path: Path, verb: list[str]) -> None:
    text = '<profiles><profile name="a"><attachment>/a</attachment></profile></profiles>'
    (tmp_path / "policy.xml").write_text(text)
    before = snapshot(tmp_path / "ks")
    outcome = keymint(*verb, "--json")
    (said,) = outcome.document["diagnostics"]
    assert (outcome.code, said["code"], said["file"]) == (1, "workspace-keystore", "ks")
    assert said["help"] == "keymint adopt ks POLICY --apply -w WORKSPACE"
    assert snapshot(tmp_path / "ks") == before


@pytest.mark.parametrize("part", ["enclaves", "enclaves/talker", "enclaves/robot1/listener"])
def test_a_part_of_a_keystore_leads_to_the_keystore(keymint, keystore: Path, part: str) -> None:
    (said,) = keymint("adopt", f"ks/{part}", "--json").document["diagnostics"]
    assert (said["code"], said["help"]) == ("keystore-unknown", "did you mean ks?")


@pytest.mark.parametrize(
    ("secret", "why", "remedy"),
    [
        (b"secret", "ks/private/ca.key.pem is encrypted or a container", "decrypt it (openssl pkey)"),
        (None, "ks/private/ca.key.pem is the key of another certificate", "keymint authority import ca"),
    ],
)
def test_a_key_of_an_authority_that_is_not_taken_is_a_warning(
    keymint, keystore: Path, secret: bytes | None, why: str, remedy: str
) -> None:
    place = keystore / "private/ca.key.pem"
    key = ec.generate_private_key(ec.SECP256R1()) if secret is None else keys.from_pem(place.read_bytes())
    encryption = BestAvailableEncryption(secret) if secret else NoEncryption()
    place.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption))
    outcome = keymint("adopt", "ks", "--json")
    (said,) = (each for each in outcome.document["diagnostics"] if each["code"] == "adopt-authority-elsewhere")
    assert (outcome.code, said["severity"]) == (3, "warning")
    assert why in said["message"]
    assert remedy in said["help"]
