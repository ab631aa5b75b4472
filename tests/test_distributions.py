# SPDX-License-Identifier: Apache-2.0
"""Each row of the tables in docs/distributions.md, provisioned, and judged by openssl."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from keymint_ros.distros import DISTROS
from keymint_ros2_dds.enclave_layout import READS_KEY_URI, reads_revocations

from tests.conftest import CHECKOUT, NOW

PAGE = (CHECKOUT / "docs/distributions.md").read_text("utf-8")
POLICY = """<profile xmlns:xi="http://www.w3.org/2001/XInclude" name="talker">
  <attachment>/a/talker</attachment>
  <xi:include href="common/node.xml" parse="xml"/>
  <ros_topic qualifier="ALLOW"><attachment>/a/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
  <ros_service qualifier="ALLOW"><attachment>/a/add</attachment><permissions><ros_call/></permissions></ros_service>
</profile>
"""
SIGNED = ("permissions.p7s", "governance.p7s")


def table(heading: str) -> dict[str, list[str]]:
    """Return the cells of a table by distribution."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"]
    return {name: cells for name, *cells in rows[2:]}


def code(cell: str) -> list[str]:
    """Return what a cell has in code quotes."""
    return re.findall(r"`([^`]+)`", cell)


FILES, NAMES = table("Files"), table("Names and rights")


@pytest.fixture
def ws(keymint, tmp_path: Path, distro: str) -> Path:
    """A workspace for a distribution."""
    (tmp_path / "p.xml").write_text(POLICY)
    outcome = keymint("provision", "p.xml", "-w", "ws", "--distro", distro)
    assert outcome.code == 0, outcome.err
    return tmp_path / "ws"


def test_the_tables_have_all_distributions_in_order() -> None:
    assert list(FILES) == list(NAMES) == list(DISTROS)


@pytest.mark.parametrize("distro", DISTROS)
def test_a_row(keymint, ws: Path, distro: str) -> None:
    layout, place, authorities, also, variable = FILES[distro]
    assert f"<layout>{layout}</layout>" in (ws / "profile/keymint_profile.xml").read_text()
    folder = ws / "install" / code(place)[0]
    own = {"cert.pem", "key.pem", *SIGNED, *(["permissions.xml"] if layout == "sros2" else [])}
    assert {path.name for path in folder.iterdir()} == {*own, *code(authorities)}
    assert ("crl.pem" in also) == reads_revocations(distro, layout)
    assert ("key.p11" in also) == (distro in READS_KEY_URI)
    assert keymint("check", "-w", ws).code == 0
    assert keymint("prove", "-w", ws).code == 0
    # The node joins the variable's folder with what it looks for: its name, its namespace and name, or its enclave.
    root = ws / code(variable)[0].partition("=$PWD/")[2]
    sought = {"ardent": "talker", "bouncy": "talker", **dict.fromkeys(("crystal", "dashing", "eloquent"), "a/talker")}
    assert root / sought.get(distro, "enclaves/a/talker") == folder
    assert f"export {code(variable)[0].replace('$PWD', str(ws))}\n" in keymint("env", "/a/talker", "-w", ws).out
    openssl(folder, *code(authorities))
    names_of(ws, distro)


def openssl(folder: Path, issuer: str, signer: str = "") -> None:
    """Let openssl judge the certificate and the signed documents of an enclave, and that each signs its own only."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed: apt-get install openssl")

    def accepts(command: str, *arguments: str) -> bool:
        done = subprocess.run(
            ["openssl", command, "-attime", str(NOW), *arguments], cwd=folder, capture_output=True, check=False
        )
        return done.returncode == 0

    assert accepts("verify", "-x509_strict", "-CAfile", issuer, "cert.pem")
    for each in SIGNED:
        assert accepts("smime", "-verify", "-CAfile", signer or issuer, "-in", each)
        assert not signer or not accepts("smime", "-verify", "-CAfile", issuer, "-in", each)


def names_of(ws: Path, distro: str) -> None:
    """Compare the names in the permissions with the second table."""
    topic, request, granted, _ = NAMES[distro]
    document = (ws / "build/a/talker/permissions.xml").read_text()
    for cell in (topic, request):
        name, *partition = code(cell)
        assert f"<topic>{name}</topic>" in document
        assert all(f"<partition>{each}</partition>" in document for each in partition)
    assert ("<partition>" in document) == (distro == "ardent")
    assert ("<topic>rt/rosout</topic>" in document) == ("`/rosout`" in granted)
    assert ("<topic>ros_discovery_info</topic>" in document) == ("`ros_discovery_info`" in granted)
    assert ("get_type_description" in document) == ("`get_type_description`" in granted)


@pytest.mark.parametrize("distro", ["iron", "rolling"])
def test_events_of_services_and_loggers_are_included_on_demand(keymint, distro: str, tmp_path: Path) -> None:
    includes = "".join(
        f'<xi:include href="common/node/{name}.xml" parse="xml"/>' for name in ("service_events", "logger_levels")
    )
    (tmp_path / "p.xml").write_text(POLICY.replace("<ros_topic", f"{includes}<ros_topic", 1))
    assert keymint("provision", "p.xml", "-w", "ws", "--distro", distro).code == 0
    document = (tmp_path / "ws/build/a/talker/permissions.xml").read_text()
    for name in ("rt/a/talker/*/_service_event", "rq/a/talker/get_logger_levelsRequest"):
        assert f"<topic>{name}</topic>" in document


def test_two_authorities_do_not_fit_into_one_file(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(POLICY)
    assert keymint("provision", "p.xml", "-w", "ws", "--distro", "eloquent").code == 0
    profile = tmp_path / "ws/profile/keymint_profile.xml"
    profile.write_text(profile.read_text().replace("<distro>eloquent<", "<distro>bouncy<"))
    outcome = keymint("provision", "p.xml", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["layout-authorities"])
    found = outcome.document["diagnostics"][0]
    assert "in Bouncy" in found["message"]
    assert (tmp_path / found["file"]).is_file(), found


def test_files_of_another_distribution_are_removed(keymint, tmp_path: Path) -> None:
    """A workspace for Crystal that an earlier version made has one authority and one file for it."""
    (tmp_path / "p.xml").write_text(POLICY)
    assert keymint("provision", "p.xml", "-w", "ws", "--distro", "bouncy").code == 0
    profile = tmp_path / "ws/profile/keymint_profile.xml"
    profile.write_text(profile.read_text().replace("<distro>bouncy<", "<distro>crystal<"))
    assert keymint("build", "-w", "ws").code == 0
    assert keymint("install", "-w", "ws").code == 0
    folder = tmp_path / "ws/install/a/talker"
    names = {path.name for path in folder.iterdir()}
    assert {"identity_ca.cert.pem", "permissions_ca.cert.pem"} < names
    assert "ca.cert.pem" not in names
    assert (folder / "identity_ca.cert.pem").read_bytes() == (folder / "permissions_ca.cert.pem").read_bytes()
