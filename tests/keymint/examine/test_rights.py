# SPDX-License-Identifier: Apache-2.0
"""The claim about the whole keystore: whatever a holder presents, it gets no more than its policy."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from keymint.robots import bundle
from tests import sros2_keystore
from tests.conftest import NOW, Outcome

from .fault_keystores import LISTENER, TALKER, first_grant, new_grant, put
from .presented import EVERYTHING, codes, findings, for_listener, keystore, notes, signed, wider

VERBS = ("check", "prove")
MODELS = {"omg", "cyclonedds-0.10", "cyclonedds-11", "fastdds-2.9", "fastdds-2.11", "fastdds-3.3"}
ACTION = "use of any signed document"
YEAR = 366 * 86_400


class TestWhatOthersMayPresent:
    """A participant chooses the document that it presents, and each vendor the grant in it."""

    @pytest.mark.parametrize("verb", VERBS)
    def test_a_second_grant_for_another_subject(self, keymint, provisioned: Path, verb: str) -> None:
        store = keystore(provisioned)
        store.sign_permissions(TALKER, for_listener(store))
        found = [each for each in findings(keymint, provisioned, verb) if each["code"] == "counterexample"]
        mine = [each["message"] for each in found if each["message"].startswith("/robot1/listener: ")]
        assert any("the document permits it to publish " in each for each in mine)
        assert all("install/enclaves/talker/permissions" in each for each in mine), "the file is named"

    def test_prove_refutes_the_claim_of_every_vendor(self, keymint, provisioned: Path) -> None:
        store = keystore(provisioned)
        store.sign_permissions(TALKER, for_listener(store))
        (shared,) = keymint("prove", "--json", cwd=provisioned).document["result"]["shared"]
        refuted = {each["model"] for each in shared["claims"] if each["proof"] == "counterexample"}
        assert refuted == MODELS

    @pytest.mark.parametrize("name", ["CN={cn},CN={cn}", "CN={cn},OU=", 'CN="{cn}",OU={ou}', "CN={cn},OU={ou},x"])
    def test_a_grant_whose_odd_name_fits_another_holder_on_newer_vendors(self, keymint, provisioned, name: str) -> None:
        """Fast DDS from 2.11 on compares the first attribute of a type, and reads a name up to what is none."""
        store = keystore(provisioned)
        cn, ou = (part.partition("=")[2] for part in store.name(LISTENER).split(","))
        document = store.permissions(TALKER)
        grant = first_grant(document)
        grant.addnext(new_grant(grant, name.format(cn=cn, ou=ou), EVERYTHING))
        put(provisioned / "src/old.p7s", signed(store, document))
        found = [each for each in findings(keymint, provisioned, "prove") if each["code"] == "counterexample"]
        mine = [each["message"] for each in found if each["message"].startswith("/robot1/listener: ")]
        if name.endswith("OU="):  # Fast DDS reads an absent attribute as an empty one, but the listener has an OU
            assert not mine
        else:
            assert any("fastdds-2.11, fastdds-3.3" in each for each in mine), found

    @pytest.mark.parametrize("verb", VERBS)
    @pytest.mark.parametrize("file", ["src/old.p7s", "src/talker/permissions.p7s", "build/x", "profile/y.p7s", "z.p7s"])
    def test_a_signed_document_that_lies_anywhere(self, keymint, provisioned: Path, verb: str, file: str) -> None:
        store = keystore(provisioned)
        put(provisioned / file, signed(store, for_listener(store)))
        found = [each for each in findings(keymint, provisioned, verb) if each["code"] == "counterexample"]
        assert found
        assert all(file in each["message"] for each in found)

    @pytest.mark.parametrize("verb", VERBS)
    def test_a_signed_document_in_a_bundle(self, keymint, provisioned: Path, verb: str) -> None:
        store = keystore(provisioned)
        put(provisioned / "robot.bundle", bundle.pack({"permissions.p7s": signed(store, wider(store))}))
        found = [each for each in findings(keymint, provisioned, verb) if each["code"] == "counterexample"]
        assert found
        assert all("robot.bundle" in each["message"] for each in found)

    @pytest.mark.parametrize("folder", ["extra", "robot1/listener"])
    def test_an_enclave_vouches_for_its_own_package_only(self, keymint, provisioned: Path, folder: str) -> None:
        """Talker's certificate beside wider permissions for it, in an enclave that nobody asked about."""
        store = keystore(provisioned)
        enclave = provisioned / "install/enclaves" / folder
        enclave.mkdir(exist_ok=True)
        put(enclave / "permissions.p7s", signed(store, wider(store)))
        put(enclave / "cert.pem", (provisioned / "install/enclaves/talker/cert.pem").read_bytes())
        found = findings(keymint, provisioned, "prove", "talker")
        assert {f"install/enclaves/{folder}/permissions" in each["message"] for each in found} >= {True}

    @pytest.mark.parametrize("verb", VERBS)
    def test_what_a_foreign_authority_signed_is_presented_to_nobody(self, keymint, made, provisioned, verb) -> None:
        foreign = keystore(made / "foreign")
        put(provisioned / "src/old.p7s", signed(foreign, for_listener(keystore(provisioned))))
        assert codes(keymint, provisioned, verb) == set()

    def test_a_sound_keystore_has_a_claim_for_each_way_to_choose_a_grant(self, keymint, provisioned: Path) -> None:
        (shared,) = keymint("prove", "--json", cwd=provisioned).document["result"]["shared"]
        assert {(each["model"], each["action"], each["proof"]) for each in shared["claims"]} == {
            (model, ACTION, "proven") for model in MODELS
        }

    def test_a_workspace_for_zenoh_alone_has_no_documents_to_present(self, keymint, policy: Path, tmp_path) -> None:
        assert keymint("provision", policy, "-w", "ws", "--transport", "zenoh").code == 0
        outcome = keymint("prove", "-v", "--json", cwd=tmp_path / "ws")
        assert outcome.code == 0
        assert ACTION not in outcome.out
        assert "before the register began" not in outcome.out


@pytest.fixture
def narrowed(keymint, provisioned: Path) -> Path:
    """A workspace whose talker was allowed to publish more, by a document that is good for a year."""
    policy = provisioned.parent / "policy.xml"
    more = policy.read_text().replace("<ros_publish/>", "<ros_publish/><ros_subscribe/>")
    for text in (more, policy.read_text()):
        policy.write_text(text)
        assert keymint("provision", policy, "-w", provisioned).code == 0
    return provisioned


def outliving(keymint: Callable[..., Outcome], ws: Path, **env: object) -> Mapping[str, tuple[int, int, int]]:
    """Return how often each verb notes earlier rights, and its exit code without and with ``--strict``."""
    found = {}
    settings = {name: str(value) for name, value in env.items()}
    for verb in (*VERBS, "status"):
        outcome, strict = (keymint(verb, *words, "--json", cwd=ws, env=settings) for words in ((), ("--strict",)))
        found[verb] = len(notes(outcome, "rights-outlive")), outcome.code, strict.code
    return found


NOTED = dict.fromkeys((*VERBS, "status"), (1, 0, 3))
QUIET = dict.fromkeys((*VERBS, "status"), (0, 0, 0))


class TestEarlierRights:
    """A signed document is good until it ends; the register remembers those that are no longer here."""

    def test_each_verb_notes_them_every_time(self, keymint, narrowed: Path) -> None:
        assert outliving(keymint, narrowed) == NOTED
        assert outliving(keymint, narrowed) == NOTED, "from the record, too"
        (note,) = notes(keymint("check", "--json", cwd=narrowed), "rights-outlive")
        assert note["subject"] == "/talker"
        assert "/talker more than the policy, e.g. to subscribe 'rt/chatter'" in note["message"]
        assert "until 2028-01-14T00:00:00Z" in note["message"]
        assert "'keymint revoke talker --reason superseded'" in note["help"]
        assert "'keymint issued talker --tolerate'" in note["help"]

    def test_the_record_of_a_sound_keystore_hides_nothing(self, keymint, narrowed: Path) -> None:
        """A proof is bound to the bytes that it is about."""
        store = keystore(narrowed)
        for verb in VERBS:
            assert keymint(verb, cwd=narrowed).code == 0  # is recorded
        store.sign_permissions(TALKER, for_listener(store))
        for verb in VERBS:
            assert "counterexample" in codes(keymint, narrowed, verb)

    def test_until_the_certificate_is_revoked(self, keymint, narrowed: Path) -> None:
        assert keymint("revoke", "talker", "--reason", "superseded", cwd=narrowed).code == 0
        assert outliving(keymint, narrowed) == QUIET

    def test_until_the_owner_accepts_them(self, keymint, narrowed: Path) -> None:
        outcome = keymint("issued", "talker", "--tolerate", cwd=narrowed)
        assert (outcome.code, outcome.err) == (0, "")
        assert outcome.out.splitlines()[-1] == "1 updated"
        assert outliving(keymint, narrowed) == QUIET
        again = keymint("issued", "talker", "--tolerate", cwd=narrowed)
        assert (again.code, again.out) == (0, "nothing to do: 1 package up to date\n")

    def test_an_acceptance_is_for_what_was_signed_before_it(self, keymint, narrowed: Path) -> None:
        assert keymint("issued", "talker", "--tolerate", cwd=narrowed).code == 0
        policy = narrowed.parent / "policy.xml"
        without = policy.read_text()
        policy.write_text(without.replace(">/chatter<", ">/chatt*<"))
        assert keymint("provision", policy, "-w", narrowed).code == 0
        policy.write_text(without)
        assert keymint("provision", policy, "-w", narrowed).code == 0
        (note, *_) = notes(keymint("check", "--json", cwd=narrowed), "rights-outlive")
        assert "'rt/chatt" in note["message"]

    @pytest.mark.parametrize(("names", "lacks"), [((), "document"), (("robot1/other",), "package")])
    def test_an_acceptance_names_packages_with_documents(self, keymint, narrowed: Path, names, lacks) -> None:
        outcome = keymint("issued", *names, "--tolerate", cwd=narrowed)
        assert outcome.code == 1
        assert outcome.err.startswith(f"error: no {lacks} ")
        assert outliving(keymint, narrowed) == NOTED

    def test_until_the_date_has_passed(self, keymint, narrowed: Path) -> None:
        later = NOW + YEAR - 40 * 86_400
        env = {"SOURCE_DATE_EPOCH": str(later)}
        assert keymint("renew", "talker", "robot1/listener", cwd=narrowed, env=env).code == 0
        assert outliving(keymint, narrowed, SOURCE_DATE_EPOCH=later) == NOTED
        assert outliving(keymint, narrowed, SOURCE_DATE_EPOCH=NOW + YEAR) == QUIET

    def test_a_renewal_alone_changes_no_rights(self, keymint, provisioned: Path) -> None:
        later = {"SOURCE_DATE_EPOCH": str(NOW + 30 * 86_400)}
        before = (provisioned / "install/enclaves/talker/permissions.p7s").read_bytes()
        assert keymint("renew", "talker", cwd=provisioned, env=later).code == 0
        assert (provisioned / "install/enclaves/talker/permissions.p7s").read_bytes() != before
        assert outliving(keymint, provisioned, **later) == QUIET

    def test_wider_rights_are_no_news(self, keymint, provisioned: Path) -> None:
        """What was signed before permits less."""
        policy = provisioned.parent / "policy.xml"
        policy.write_text(policy.read_text().replace("<ros_publish/>", "<ros_publish/><ros_subscribe/>"))
        assert keymint("provision", policy, "-w", provisioned).code == 0
        assert outliving(keymint, provisioned) == QUIET


ASSUMPTION = "assumption: nothing wider was signed before the register began to keep signed documents"


class TestTheRegister:
    """It keeps what was signed; an older one did not."""

    def test_it_has_each_signed_document(self, narrowed: Path) -> None:
        with sqlite3.connect(narrowed / "private/register.sqlite3") as database:
            rows = database.execute("SELECT name, generation FROM rights").fetchall()
            assert rows.count(("talker", 0)) == len(("the first and the last, which are equal", "the wider one"))

    def test_a_complete_history_is_no_assumption(self, keymint, provisioned: Path) -> None:
        assert ASSUMPTION not in keymint("prove", "-v", cwd=provisioned).err

    def test_version_1_is_read_and_its_history_is_an_assumption(self, keymint, narrowed: Path) -> None:
        older(narrowed / "private/register.sqlite3")
        outcome = keymint("prove", "-v", cwd=narrowed)
        assert outcome.code == 0
        assert f"note: {ASSUMPTION}" in outcome.err
        assert "rights-outlive" not in outcome.err, "nobody knows of them"
        assert keymint("check", cwd=narrowed).code == 0

    def test_the_assumption_stays_when_a_verb_writes_the_register(self, keymint, provisioned: Path) -> None:
        register = provisioned / "private/register.sqlite3"
        older(register)
        assert keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned).code == 0
        with sqlite3.connect(register) as database:
            assert database.execute("PRAGMA user_version").fetchone() == (3,)
            assert database.execute("SELECT * FROM history").fetchall() == [(0,)]
        assert ASSUMPTION in keymint("prove", "-v", cwd=provisioned).err

    @pytest.mark.parametrize("content", ["00", "789c"])
    def test_documents_that_do_not_inflate_are_damage(self, keymint, narrowed: Path, content: str) -> None:
        database = sqlite3.connect(narrowed / "private/register.sqlite3")
        database.execute(f"UPDATE rights SET compressed = x'{content}'")
        database.commit()
        database.close()
        outcome = keymint("check", "--json", cwd=narrowed)
        assert (outcome.code, outcome.codes()) == (3, ["register-damaged"])


def older(register: Path) -> None:
    """Make a register one of version 1, which had certificates, lists and bundles alone."""
    database = sqlite3.connect(register)
    database.executescript("DROP TABLE rights; DROP TABLE history; PRAGMA user_version = 1; VACUUM;")
    database.close()


class TestOneAuthority:
    """Where the authority of identities signs documents, holders sign their own for some vendors."""

    @pytest.fixture
    def adopted(self, keymint, tmp_path: Path) -> Path:
        (tmp_path / "sros2.xml").write_text(SROS2)
        sros2_keystore.make(tmp_path / "ks", SROS2)
        for path in (tmp_path / "ks").rglob("*.pem"):
            path.chmod(0o600 if "key" in path.name else 0o644)
        assert keymint("adopt", "ks", "sros2.xml", "--apply", "-w", "ws").code == 0
        return tmp_path / "ws"

    def test_it_is_an_exception_that_names_harden(self, keymint, adopted: Path) -> None:
        outcome = keymint("prove", cwd=adopted)
        assert outcome.code == 0
        (line,) = (line for line in outcome.out.splitlines() if line.startswith("not part of the proof: "))
        assert "holders sign their own permissions" in line
        assert "'keymint harden'" in line
        (shared,) = keymint("prove", "--json", cwd=adopted).document["result"]["shared"]
        excepted = {each["model"] for each in shared["claims"] if each["except"]}
        assert excepted == {"cyclonedds-0.10", "fastdds-2.9"}

    @pytest.mark.parametrize("verb", VERBS)
    def test_strict_refuses_it(self, keymint, adopted: Path, verb: str) -> None:
        assert "proof-exception" in codes(keymint, adopted, verb, "--strict")

    def test_the_step_ends_it(self, keymint, adopted: Path) -> None:
        assert keymint("harden", "authority", "--apply", "--flag-day", cwd=adopted).code == 0
        assert keymint("prove", "--strict", cwd=adopted).code == 0

    def test_two_authorities_have_no_exception(self, keymint, provisioned: Path) -> None:
        assert keymint("prove", "--strict", cwd=provisioned).code == 0


SROS2 = """<policy version="0.2.0"><enclaves>
  <enclave path="/talker"><profiles><profile ns="/" node="talker">
    <topics publish="ALLOW"><topic>chatter</topic></topics></profile></profiles></enclave>
</enclaves></policy>"""
