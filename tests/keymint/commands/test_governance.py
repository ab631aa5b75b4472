# SPDX-License-Identifier: Apache-2.0
"""A governance that leaves topics open: found at build, refused by install and prove, accepted in the profile."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from keymint.pki import certificates, keys, smime

WRITE = "enable_write_access_control"
ACCEPT = "<exceptions><open_governance/></exceptions>"


def open_sources(workspace: Path, tag: str = WRITE, value: str = "false") -> int:
    """Open every topic in the defaults; return the line of the rule."""
    file = workspace / "profile/package.defaults/governance.xml"
    text = re.sub(f"<{tag}>.*?</{tag}>", "", file.read_text())
    inside = "</topic_rule>" if "access_control" in tag and "join" not in tag else "<topic_access_rules>"
    text = text.replace(inside, f"<{tag}>{value}</{tag}>{inside}", 1)
    file.write_text(text)
    return next(n for n, line in enumerate(text.splitlines(), 1) if "<topic_rule>" in line)


def accept(workspace: Path) -> None:
    file = workspace / "profile/keymint_profile.xml"
    file.write_text(file.read_text().replace("</profile>", f"{ACCEPT}</profile>"))


def resign(workspace: Path, *changes: tuple[str, str]) -> None:
    """Change the signed governance of an enclave, and sign it by the workspace's authority."""
    file = workspace / "install/enclaves/talker/governance.p7s"
    content = smime.signed_content(file.read_bytes()).decode()
    for old, new in changes:
        assert old in content
        content = content.replace(old, new, 1)
    certificate = certificates.load((workspace / "public/permissions_ca.cert.pem").read_bytes())
    key = keys.from_pem((workspace / "private/permissions_ca.key.pem").read_bytes(), None)
    file.write_bytes(smime.sign(content.encode(), certificate, key))


@pytest.fixture
def opened(keymint: Callable, provisioned: Path) -> Path:
    """A workspace whose sources open every topic, installed without proof."""
    open_sources(provisioned)
    assert keymint("build", "-w", provisioned).code == 0
    assert keymint("install", "-w", provisioned, "--no-prove").code == 0
    return provisioned


def test_the_build_warns_at_the_rule_once_for_all_packages(keymint: Callable, provisioned: Path) -> None:
    line = open_sources(provisioned)
    outcome = keymint("build", "-w", provisioned)
    assert outcome.code == 0
    assert outcome.err.count(f"{WRITE} is false for '*'") == 1
    assert f"package.defaults/governance.xml:{line}: warning: " in outcome.err
    assert ACCEPT in outcome.err


def test_install_refuses_with_a_counterexample_that_names_the_option(keymint: Callable, provisioned: Path) -> None:
    open_sources(provisioned)
    keymint("build", "-w", provisioned)
    before = (provisioned / "install/enclaves/talker/governance.p7s").read_bytes()
    outcome = keymint("install", "-w", provisioned)
    assert outcome.code == 3
    assert re.search(
        r"build/robot1/listener/governance\.xml:\d+: error: /robot1/listener: the document permits it to publish",
        outcome.err,
    )
    assert ACCEPT in outcome.err
    assert (provisioned / "install/enclaves/talker/governance.p7s").read_bytes() == before


def test_prove_and_check_find_what_is_open(keymint: Callable, opened: Path) -> None:
    outcome = keymint("prove", "-w", opened, "--json")
    assert outcome.code == 3
    claims = outcome.document["result"]["enclaves"][0]["claims"]
    wrong = [claim for claim in claims if claim["proof"] == "counterexample"]
    assert {claim["action"] for claim in wrong} == {"publish"}
    for claim in wrong:
        document = claim["counterexample"]["document"]
        assert document["file"].endswith("governance.p7s")
        assert f"{WRITE} is false" in document["reason"]
    outcome = keymint("check", "-w", opened, "--json")
    assert (outcome.code, outcome.codes()) == (3, ["governance-open", "counterexample"])


def test_the_option_makes_it_an_exception_that_is_said(keymint: Callable, opened: Path) -> None:
    accept(opened)
    assert keymint("build", "-w", opened, "-v").err.count("the profile accepts it") == 1
    outcome = keymint("install", "-w", opened)
    assert outcome.code == 0, outcome.err
    for unchanged in (True, True):
        outcome = keymint("prove", "-w", opened)
        assert outcome.code == 0, outcome.err
        assert "18 of 18 claims proven" in outcome.out
        assert "not part of the proof: " in outcome.out
        assert re.search(
            r"/talker, publish '\*' \(\S*governance\.xml:\d+: enable_write_access_control is false\)", outcome.out
        )
        enclaves = keymint("prove", "-w", opened, "--json").document["result"]["enclaves"]
        assert [enclave["unchanged"] for enclave in enclaves] == [unchanged] * 2
        for claim in enclaves[0]["claims"]:
            assert bool(claim["except"]) is (claim["action"] == "publish")
    assert keymint("check", "-w", opened).code == 0


def test_taking_the_option_back_is_no_secret_to_the_record(keymint: Callable, opened: Path) -> None:
    accept(opened)
    keymint("install", "-w", opened)
    assert keymint("prove", "-w", opened).code == 0
    file = opened / "profile/keymint_profile.xml"
    file.write_text(file.read_text().replace(ACCEPT, ""))
    assert keymint("prove", "-w", opened).code == 3


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ((f"<{WRITE}>true", f"<{WRITE}>false"), "governance-weaker"),
        (("<enable_read_access_control>true", "<enable_read_access_control>false"), "governance-weaker"),
        (("<enable_join_access_control>true", "<enable_join_access_control>false"), "governance-weaker"),
        (
            ("<allow_unauthenticated_participants>false", "<allow_unauthenticated_participants>true"),
            "governance-weaker",
        ),
        (("<rtps_protection_kind>SIGN", "<rtps_protection_kind>NONE"), "governance-weaker"),
    ],
)
def test_what_is_signed_by_hand_is_found_whatever_the_record_says(
    keymint: Callable, provisioned: Path, change: tuple[str, str], code: str
) -> None:
    assert keymint("prove", "-w", provisioned).code == 0
    resign(provisioned, change)
    assert keymint("prove", "-w", provisioned).code == 3
    (provisioned / ".keymint/state.json").unlink(missing_ok=True)
    outcome = keymint("check", "-w", provisioned, "--json")
    assert outcome.code == 3
    assert code in outcome.codes()
    found = next(each for each in outcome.document["diagnostics"] if each["code"] == code)
    assert found["file"].endswith("install/enclaves/talker/governance.p7s")
    assert found["line"] > 0


def test_an_unknown_acceptance_is_an_error(keymint: Callable, provisioned: Path) -> None:
    file = provisioned / "profile/keymint_profile.xml"
    file.write_text(file.read_text().replace("</profile>", "<exceptions><everything/></exceptions></profile>"))
    outcome = keymint("build", "-w", provisioned)
    assert outcome.code == 1
    assert "everything" in outcome.err
