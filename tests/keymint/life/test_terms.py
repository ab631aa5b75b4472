# SPDX-License-Identifier: Apache-2.0
"""Proofs report when the documents are valid, also when the proof is cached."""

from __future__ import annotations

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
    assert "expired on 2027-01-15T01:00:00Z, as fastdds-2.11 reads its dates" in found[0]["message"]
    assert "'keymint renew talker -w" in found[0]["help"]  # without its name it is not due
    (enclave,) = outcome.document["result"]["enclaves"]
    assert {claim["model"]: claim["until"] for claim in enclave["claims"]} == {
        "omg": "2027-01-15T09:00:00Z",
        "cyclonedds-0.10": "2027-01-15T09:00:00Z",
        "fastdds-2.11": None,
    }
