# SPDX-License-Identifier: Apache-2.0
"""``--transport`` of ``init`` and ``provision``, and the packages that a transport needs beside those of the policy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from lxml import etree

from keymint.api import plugin_loader
from keymint.run import run
from tests.conftest import snapshot
from tests.keymint import lighthouse
from tests.keymint.lighthouse import TOWER

LIGHT = ("--transport", "light")
BOTH = ("--transport", "dds", *LIGHT)


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second transport is installed."""
    monkeypatch.setattr(run, "entries_in", lambda metadata: (*plugin_loader.entries_in(metadata), *lighthouse.ENTRIES))


def build_types(manifest: Path) -> list[str]:
    return [element.text for element in etree.parse(manifest).iterfind("export/build_type")]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def usages(certificate: Path) -> set[x509.ObjectIdentifier]:
    loaded = x509.load_pem_x509_certificate(certificate.read_bytes())
    return {*loaded.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value}


def prepared(keymint: Callable, tmp_path: Path, policy: Path, *options: str) -> Path:
    """Return a workspace with sources, documents and enclaves; nothing is proven."""
    outcome = keymint("provision", policy, "-w", "ws", "--no-prove", *options)
    assert outcome.code == 0, outcome.err
    return tmp_path / "ws"


def test_without_the_option_nothing_changes(keymint, tmp_path: Path) -> None:
    for name, options in (("plain", ()), ("named", ("--transport", "dds"))):
        assert keymint("init", name, *options).code == 0
        assert keymint("create", "--all", "-w", name).code == 0
    plain, named = (contents(tmp_path / name / "src") for name in ("plain", "named"))
    assert plain == named
    assert build_types(tmp_path / "plain/src/talker/keymint_package.xml") == ["keymint_ros2_dds"]
    profiles = [(tmp_path / name / "profile/keymint_profile.xml").read_text() for name in ("plain", "named")]
    assert profiles[0].replace("plain", "named") == profiles[1]


def test_a_workspace_of_the_other_transport_has_nothing_of_the_first(keymint, tmp_path: Path, policy: Path) -> None:
    ws = prepared(keymint, tmp_path, policy, *LIGHT)
    assert build_types(ws / "profile/keymint_profile.xml") == [lighthouse.NAME]
    assert build_types(ws / "src/talker/keymint_package.xml") == [lighthouse.NAME]
    assert not list(ws.rglob("*governance*"))
    assert {path.name for path in (ws / "install/enclaves/talker").iterdir()} == {"light.txt", "cert.pem", "key.pem"}


def test_both_transports_share_an_enclave_and_its_certificate(keymint, tmp_path: Path, policy: Path) -> None:
    ws = prepared(keymint, tmp_path, policy, *BOTH)
    for manifest in ("profile/keymint_profile.xml", "src/talker/keymint_package.xml"):
        assert build_types(ws / manifest) == ["keymint_ros2_dds", lighthouse.NAME]
    assert {"light.txt", "governance.p7s"} <= {path.name for path in (ws / "install/enclaves/talker").iterdir()}
    assert usages(ws / "install/enclaves/talker/cert.pem") == {ExtendedKeyUsageOID.CLIENT_AUTH}
    assert usages(ws / f"install/enclaves/{TOWER}/cert.pem") == {ExtendedKeyUsageOID.SERVER_AUTH}
    before = snapshot(ws)
    assert keymint("provision", policy, "-w", "ws", "--no-prove").code == 0
    assert snapshot(ws) == before


def test_certificates_of_the_first_transport_alone_keep_both_usages(keymint, provisioned: Path) -> None:
    both = {ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH}
    assert usages(provisioned / "install/enclaves/talker/cert.pem") == both


@pytest.mark.parametrize("verb", [("init", "ws"), ("provision", "policy.xml", "-w", "ws")], ids=lambda verb: verb[0])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--transport", "lihgt"), "no build type for the transport 'lihgt' is installed (did you mean 'light'?)"),
        ((*LIGHT, "--layout", "flat"), "the transport light has no layout 'flat'"),
        ((*LIGHT, "--distro", "ardent"), "the transport light has no layout 'flat'"),
        ((*LIGHT, "--distro", "foxy"), "there is no light in foxy"),
    ],
)
def test_what_a_transport_cannot_serve_is_refused_at_once(
    keymint, tmp_path: Path, policy: Path, verb: tuple[str, ...], options: tuple[str, ...], message: str
) -> None:
    outcome = keymint(*verb, *options)
    assert outcome.code != 0
    assert message in outcome.err
    assert not (tmp_path / "ws").exists()


@pytest.mark.parametrize("verb", [("init", "ws"), ("provision", "policy.xml", "-w", "ws")], ids=lambda verb: verb[0])
def test_another_transport_for_a_workspace_that_exists_is_refused(
    keymint, tmp_path: Path, policy: Path, verb: tuple[str, ...]
) -> None:
    prepared(keymint, tmp_path, policy, *BOTH)
    assert keymint(*verb, *LIGHT, "--transport", "dds").code == 0
    before = snapshot(tmp_path)
    outcome = keymint(*verb, *LIGHT)
    assert outcome.code == 1
    assert "has transport 'dds' and 'light', so --transport light cannot take effect" in outcome.err
    assert "</build_type> in <export> of ws/profile/keymint_profile.xml and of each existing package" in outcome.err
    assert snapshot(tmp_path) == before


def test_create_adds_the_infrastructure_to_any_subject(keymint, tmp_path: Path) -> None:
    assert keymint("init", "ws", *BOTH).code == 0
    ws = tmp_path / "ws"
    assert keymint("status", "-w", "ws", "--json").document["result"]["not_created"] == ["listener", "talker", TOWER]
    assert keymint("create", "talker", "-w", "ws").code == 0
    assert {path.name for path in (ws / "src").iterdir()} == {"talker", TOWER}
    assert {path.name for path in (ws / "src" / TOWER).iterdir()} == {"keymint_package.xml", "identities.xml"}
    assert build_types(ws / f"src/{TOWER}/keymint_package.xml") == [lighthouse.NAME]
    assert "<role>infrastructure</role>" in (ws / f"src/{TOWER}/keymint_package.xml").read_text()
    before = snapshot(ws / "src")
    assert keymint("create", TOWER, "talker", "-w", "ws").code == 0
    assert snapshot(ws / "src") == before


def test_infrastructure_is_no_subject_of_the_policy(keymint, tmp_path: Path, policy: Path) -> None:
    """Even a profile for every subject gives it nothing, and nobody is told that it is out of date."""
    everybody = "<profile name='all'><attachment>/**</attachment><ros_topic qualifier='ALLOW'>"
    everybody += "<attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic></profile></profiles>"
    policy.write_text(policy.read_text().replace("</profiles>", everybody))
    ws = prepared(keymint, tmp_path, policy, *LIGHT)
    assert "x" in (ws / "install/enclaves/talker/light.txt").read_text()
    assert (ws / f"install/enclaves/{TOWER}/light.txt").read_text() == str(ws / "install")
    policy.write_text(policy.read_text().replace("/chatter", "/other"))
    outcome = keymint("build", "-w", "ws")
    assert "2 source packages out of date with the policy, which changed: /robot1/listener, /talker" in outcome.err
    rows = {
        row["package"]: row["stale"] for row in keymint("status", "-w", "ws", "--json").document["result"]["packages"]
    }
    assert rows[TOWER] != "create"
    outcome = keymint("create", "--all", "-w", "ws")
    assert (outcome.code, outcome.err) == (0, "")


def test_a_package_knows_the_infrastructure_of_its_build_types(keymint, tmp_path: Path, policy: Path) -> None:
    ws = prepared(keymint, tmp_path, policy, *LIGHT)
    assert TOWER in (ws / "build/talker/light.txt").read_text()
    identities = ws / f"src/{TOWER}/identities.xml"
    named = "<identity><cert><subject_name>CN=beacon</subject_name></cert></identity>"
    identities.write_text(identities.read_text().replace("<identity/>", named))
    assert keymint("build", "talker", "-w", "ws").code == 0
    assert "CN=beacon" in (ws / "build/talker/light.txt").read_text()


def test_documents_that_name_the_install_space_are_built_again_when_it_moves(
    keymint, tmp_path: Path, policy: Path
) -> None:
    prepared(keymint, tmp_path, policy, *LIGHT).rename(tmp_path / "moved")
    rows = keymint("status", "-w", "moved", "--json").document["result"]["packages"]
    assert {row["stale"] for row in rows} == {"build"}
    assert keymint("build", "-w", "moved").code == 0
    assert (tmp_path / "moved/build/talker/light.txt").read_text().startswith(f"{tmp_path}/moved/install\n")


def test_the_policy_must_not_name_infrastructure(keymint, tmp_path: Path, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("<attachment>/talker<", f"<attachment>/{TOWER}<"))
    outcome = keymint("provision", policy, "-w", "ws", *LIGHT)
    assert outcome.code == 1
    assert f"policy.xml:2: error: the policy names /{TOWER}, which is the lighthouse and no subject" in outcome.err
    assert not (tmp_path / "ws").exists()


def test_status_tells_what_a_transport_cannot_read(keymint, tmp_path: Path, policy: Path) -> None:
    manifest = prepared(keymint, tmp_path, policy, *LIGHT) / "profile/keymint_profile.xml"
    manifest.write_text(manifest.read_text().replace("<distro>jazzy<", "<distro>foxy<"))
    outcome = keymint("status", "-w", "ws", "--json")
    assert outcome.code == 0
    assert outcome.codes().count("light-distro") == 1
    assert len(outcome.document["result"]["packages"]) == 3


def test_a_subject_that_has_the_name_already(keymint, tmp_path: Path, policy: Path) -> None:
    ws = prepared(keymint, tmp_path, policy, *LIGHT)
    (ws / "profile/package.defaults/lighthouse.xml").write_text("talker")
    policy.write_text(policy.read_text().replace("<attachment>/talker<", "<attachment>/speaker<"))
    outcome = keymint("create", "--all", "-w", "ws")
    assert outcome.code == 1
    assert (
        "src/talker/keymint_package.xml: error: the package is that of a subject, but a transport needs one"
        in outcome.err
    )
