# SPDX-License-Identifier: Apache-2.0
"""``keymint harden``: the steps after a keystore was taken over, each with its cost."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509

from tests.conftest import NOW
from tests.keymint.commands.exchange.test_adopt import POLICY, made, snapshot
from tests.keymint.commands.exchange.test_adopt_apply import complete, files


@pytest.fixture
def adopted(keymint, tmp_path: Path) -> Path:
    made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    return tmp_path / "ws"


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def steps(keymint) -> list[str]:
    return [each["step"] for each in keymint("harden", "-w", "ws", "--json").document["result"]["steps"]]


def changed(before, after) -> set[str]:
    return {path for path in after if after[path] != before.get(path)}


def test_costs_are_said_and_nothing_changes(keymint, adopted: Path) -> None:
    before = snapshot(adopted)
    lines = complete(keymint("harden", "-w", "ws")).splitlines()
    assert [line.split(":")[0] for line in lines] == ["authority", "identifiers", "names"]
    assert "requires restarting all robots together" in lines[0]
    assert "requires restarting all robots together, since ca signs documents" in lines[1]
    assert "copy it, and restart its nodes" in lines[2]
    assert complete(keymint("harden", "names", "-w", "ws")) == lines[2] + "\n"
    assert snapshot(adopted) == before


def test_the_cost_is_that_of_the_packages_that_are_named(keymint, adopted: Path) -> None:
    cost = complete(keymint("harden", "names", "-w", "ws"))
    named = complete(keymint("harden", "names", "/talker", "-w", "ws"))
    assert named.startswith("names: talker: ")
    assert complete(keymint("harden", "names", "/*", "-w", "ws")) == cost != named
    for name in ("nosuch", "/nosuch/*"):
        unknown = keymint("harden", "names", name, "-w", "ws")
        assert (unknown.code, unknown.out) == (1, "")
        assert "[package-unknown]" in unknown.err
    refused = keymint("harden", "authority", "talker", "-w", "ws")
    assert (refused.code, "concerns all packages" in refused.err) == (2, True)


def test_all_steps_in_the_order_of_the_report(keymint, adopted: Path) -> None:
    install = adopted / "install"
    original = files(install)
    for step in ("authority", "identifiers"):
        refused = keymint("harden", step, "--apply", "-w", "ws")
        assert (refused.code, "restart of all robots" in refused.err) == (1, True)
        assert files(install) == original
    complete(keymint("harden", "authority", "--apply", "--flag-day", "-w", "ws"))
    signed = files(install)
    assert changed(original, signed) == {
        "enclaves/governance.p7s", "public/permissions_ca.cert.pem",
        *(f"enclaves/{enclave}/{name}" for enclave in ("talker", "robot1/listener")
          for name in ("governance.p7s", "permissions.p7s", "permissions_ca.cert.pem")),
    }  # fmt: skip
    assert steps(keymint) == ["identifiers", "names"]
    assert "file-unexpected" not in {
        each["code"] for each in keymint("check", "-w", "ws", "--json").document["diagnostics"]
    }

    complete(keymint("harden", "identifiers", "--apply", "-w", "ws"))
    identified = files(install)
    assert {path.rpartition("/")[2] for path in changed(signed, identified)} <= {"identity_ca.cert.pem", "ca.cert.pem"}
    authority = certificate(install / "public/identity_ca.cert.pem")
    assert authority.extensions.get_extension_for_class(x509.SubjectKeyIdentifier)
    assert authority.public_key() == certificate(adopted / "public/ca.cert.pem").public_key()
    assert steps(keymint) == ["names"]

    complete(keymint("harden", "names", "talker", "--apply", "-w", "ws"))
    named = files(install)
    assert changed(identified, named) == {
        f"enclaves/talker/{name}" for name in ("cert.pem", "permissions.p7s", "permissions.xml")
    }
    subject = certificate(install / "enclaves/talker/cert.pem").subject
    assert len(list(subject)) == 2
    assert certificate(install / "enclaves/robot1/listener/cert.pem").subject.rfc4514_string() == "CN=/robot1/listener"
    assert (adopted / "private/identities/talker/key.pem").read_bytes() == named["enclaves/talker/key.pem"][1]
    complete(keymint("harden", "names", "--apply", "-w", "ws"))
    assert complete(keymint("harden", "-w", "ws")) == "nothing to do: no step is open\n"
    assert keymint("prove", "-w", "ws").code == 0
    assert complete(keymint("harden", "names", "--apply", "-w", "ws")) == "names: nothing to do\n"


def test_nothing_is_left_that_check_finds(keymint, adopted: Path) -> None:
    """A copy of the one authority lies beside those of two, until a step removes what it replaced."""
    assert (adopted / "install/public/ca.cert.pem").exists()
    complete(keymint("harden", "authority", "--apply", "--flag-day", "-w", "ws"))
    complete(keymint("harden", "identifiers", "--apply", "-w", "ws"))
    checked = keymint("check", "-w", "ws", "--json")
    assert (checked.code, {*checked.codes()}) == (0, {"node-cannot-start"})  # a note on the policy, not on the keystore
    assert complete(keymint("install", "-w", "ws")).startswith("nothing to do")


def test_the_new_authority_outlives_what_it_signs(keymint, tmp_path: Path) -> None:
    """A new authority of today lasts ten years from a day back on; these grants were made today, too."""
    made(tmp_path / "ks", now=datetime.fromtimestamp(NOW, UTC))
    (tmp_path / "policy.xml").write_text(POLICY)
    complete(keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws"))
    outcome = keymint("harden", "authority", "--apply", "--flag-day", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (0, [])
    before, after = (certificate(tmp_path / f"ws/public/{name}.cert.pem") for name in ("ca", "permissions_ca"))
    assert after.not_valid_after_utc >= before.not_valid_after_utc
    for verb in (("build", "-f"), ("install",)):
        assert keymint(*verb, "-w", "ws", "--json").codes() == []


def test_wrong_usage(keymint, adopted: Path) -> None:
    assert keymint("harden", "--apply", "-w", "ws").code == 2
    assert keymint("harden", "authority", "talker", "--apply", "-w", "ws").code == 2
    assert keymint("harden", "names", "nobody", "--apply", "-w", "ws").code == 1


def test_a_key_elsewhere_is_an_error_and_nothing_is_half_done(keymint, adopted: Path) -> None:
    (adopted / "private/ca.key.pem").unlink()
    before = files(adopted / "install"), files(adopted / "src"), files(adopted / "profile")
    for step in (("names",), ("identifiers", "--flag-day")):
        outcome = keymint("harden", *step, "--apply", "-w", "ws")
        assert outcome.code == 1
        assert "private key" in outcome.err
    assert (files(adopted / "install"), files(adopted / "src"), files(adopted / "profile")) == before


def test_what_a_person_wrote_in_another_way_is_not_edited(keymint, adopted: Path) -> None:
    path = adopted / "src/talker/identities.xml"
    path.write_text("<package><identities><identity/></identities></package>\n")
    outcome = keymint("harden", "names", "talker", "--apply", "-w", "ws")
    assert outcome.code == 1
    assert "identities.xml: error: is written in a way that Keymint does not edit" in outcome.err
    assert "{unique}" in outcome.err


def test_a_workspace_of_keymint_has_no_open_step(keymint, policy: Path) -> None:
    complete(keymint("provision", policy, "-w", "ws"))
    assert complete(keymint("harden", "-w", "ws")) == "nothing to do: no step is open\n"
