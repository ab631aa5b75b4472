# SPDX-License-Identifier: Apache-2.0
"""The distribution chooses the versions of vendors that claims are made for; what is known of installed ones."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from keymint_ros2_dds.decision.semantics import VARIATIONS, shipped_models

from tests.conftest import CHECKOUT

SHIPPED = {
    "humble": ["omg", "cyclonedds-0.10", "fastdds-2.9"],
    "jazzy": ["omg", "cyclonedds-0.10", "fastdds-2.11"],
    "kilted": ["omg", "cyclonedds-0.10", "fastdds-3.3"],
    "lyrical": ["omg", "cyclonedds-11", "fastdds-3.3"],
    "rolling": ["omg", "cyclonedds-11", "fastdds-3.3"],
}


def claimed(outcome) -> list[str]:
    claims = (claim for enclave in outcome.document["result"]["enclaves"] for claim in enclave["claims"])
    return list(dict.fromkeys(claim["model"] for claim in claims))


@pytest.mark.parametrize("distro", SHIPPED)
def test_prove_claims_for_what_the_distribution_of_the_workspace_ships(keymint: Callable, distro: str) -> None:
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws", "--distro", distro).code == 0
    outcome = keymint("prove", "-w", "ws", "--json")
    assert (outcome.code, claimed(outcome)) == (0, SHIPPED[distro])
    (shared,) = outcome.document["result"]["shared"]
    assert {each["model"] for each in shared["claims"]} == set(VARIATIONS)
    verified = keymint("verify", "-w", "ws", "--json")
    names = {each["name"] for each in verified.document["result"]["transports"]}
    assert names & set(VARIATIONS) == set(SHIPPED[distro])


def test_another_distribution_is_asked_for_and_nothing_of_it_is_recorded(keymint: Callable, provisioned: Path) -> None:
    before = keymint("prove", "-w", provisioned, "--json").document["result"]
    other = keymint("prove", "-w", provisioned, "--distro", "lyrical", "--json")
    assert (other.code, claimed(other)) == (0, SHIPPED["lyrical"])
    assert not any(each["unchanged"] for each in other.document["result"]["enclaves"])
    after = keymint("prove", "-w", provisioned, "--json")
    assert (claimed(after), [each["unchanged"] for each in after.document["result"]["enclaves"]]) == (
        SHIPPED["jazzy"], [True] * len(before["enclaves"]),
    )  # fmt: skip
    said = keymint("prove", "-w", provisioned, "--distro", "humble").out
    assert " for omg, cyclonedds-0.10 (measured), fastdds-2.9 (measured): " in said
    assert keymint("verify", "-w", provisioned, "--distro", "kilted").out.count("fastdds-3.3") == 1


@pytest.mark.parametrize("verb", ["prove", "verify"])
def test_a_distribution_that_nobody_knows(keymint: Callable, provisioned: Path, verb: str) -> None:
    outcome = keymint(verb, "-w", provisioned, "--distro", "jaszy")
    assert outcome.code == 2
    assert "unknown ROS 2 distro 'jaszy'" in outcome.err


def test_each_variation_is_a_simulated_transport() -> None:
    named = {each.name for each in entry_points(group="keymint.transports")}
    assert set(VARIATIONS) <= named
    assert {model for distro in SHIPPED for model in shipped_models(distro)} == set(VARIATIONS)


def test_check_names_what_is_known_of_listed_versions(keymint: Callable, provisioned: Path) -> None:
    asked = ("check", "-w", provisioned, "--vendors", "fastdds=2.14.1,cyclonedds=0.10.2", "--json")
    outcome = keymint(*asked)
    found = [each["message"] for each in outcome.document["diagnostics"] if each["code"] == "vendor-advisory"]
    assert outcome.code == 3
    assert any("fastdds 2.14.1 has CVE-2025-24807" in each for each in found)
    assert any("cyclonedds 0.10.2 has CVE-2023-24011" in each for each in found)
    assert keymint("check", "-w", provisioned, "--vendors", "cyclonedds=11.0.1").code == 0
    assert keymint("check", "-w", provisioned).code == 0


def test_check_reads_installed_versions(keymint: Callable, provisioned: Path, tmp_path: Path) -> None:
    manifest = tmp_path / "ros/share/fastdds/package.xml"
    manifest.parent.mkdir(parents=True)
    manifest.write_text("<package><version>3.2.0</version></package>")
    environment = {"PATH": str(tmp_path), "AMENT_PREFIX_PATH": str(tmp_path / "ros")}
    outcome = keymint("check", "-w", provisioned, "--vendors", env=environment)
    assert outcome.code == 3
    assert "fastdds 3.2.0 has CVE-2025-67108" in outcome.err


@pytest.mark.parametrize("value", ["fastdds", "fastdds=", "fastdds=new", "fastdd=2.14.1", "", "fastdds=2.1,"])
def test_a_list_of_versions_that_is_none(keymint: Callable, provisioned: Path, value: str) -> None:
    outcome = keymint("check", "-w", provisioned, f"--vendors={value}")
    assert outcome.code == 2, outcome.err
