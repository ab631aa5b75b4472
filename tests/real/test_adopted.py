# SPDX-License-Identifier: Apache-2.0
"""A keystore in the exact form of SROS2, in real participants: before and after it is adopted, and after each step.

The steps harden what SROS2 left open (docs/sros2.md). A talker and a listener exchange data after each; where a step
can be deployed enclave by enclave, also while only one of them has it. Where it cannot, that is seen as well.
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from cryptography import x509
from cryptography.x509 import AuthorityKeyIdentifier, ExtensionNotFound, SubjectKeyIdentifier

from keymint import cli
from tests import sros2_keystore

from .stages import Stages, hears

if TYPE_CHECKING:
    from pathlib import Path

    from keymint_ros2_dds.vendors.participants import System

pytestmark = pytest.mark.xdist_group("adopted keystore")
POLICY = """<policy version="0.2.0"><enclaves>
<enclave path="/talker"><profiles><profile ns="/" node="talker">
  <topics publish="ALLOW"><topic>x</topic></topics></profile></profiles></enclave>
<enclave path="/listener"><profiles><profile ns="/" node="listener">
  <topics subscribe="ALLOW"><topic>x</topic></topics></profile></profiles></enclave>
</enclaves></policy>"""
STEPS = ("sros2", "adopted", "one name", "names", "authority", "identifiers")


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Stages:
    """Make the keystore, adopt it, and harden it step by step."""
    folder = tmp_path_factory.mktemp("adopted")
    (folder / "policy.xml").write_text(POLICY)
    workspace, install = folder / "ws", folder / "ws/install"
    sros2_keystore.make(folder / "stages/sros2", POLICY)

    def keep(stage: str) -> None:
        keymint("build", "-w", workspace)
        keymint("install", "-w", workspace)
        shutil.copytree(install, folder / "stages" / stage, symlinks=True)

    keymint("adopt", folder / "stages/sros2", folder / "policy.xml", "--apply", "-w", workspace)
    keep("adopted")
    keymint("harden", "names", "talker", "--apply", "-w", workspace)
    keep("one name")
    keymint("harden", "names", "--apply", "-w", workspace)
    keep("names")
    keymint("harden", "authority", "--apply", "--flag-day", "-w", workspace)
    keep("authority")
    keymint("harden", "identifiers", "--apply", "-w", workspace)
    keymint("renew", "talker", "-w", workspace)
    keep("identifiers")
    return Stages(folder / "stages", workspace)


def keymint(*arguments: object) -> None:
    """Run the command in this process, with the clock of the machine, which vendors use."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("SOURCE_DATE_EPOCH", "ROS_DISTRO"):
            patch.delenv(name, raising=False)
        assert cli.main([str(argument) for argument in arguments]) == 0


def files(root: Path) -> dict[str, bytes | str]:
    """Return what robots have: contents of files, and targets of links."""
    return {
        path.relative_to(root).as_posix(): str(path.readlink()) if path.is_symlink() else path.read_bytes()
        for folder in ("enclaves", "public")
        for path in (root / folder).rglob("*")
        if path.is_symlink() or path.is_file()
    }


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def has(own: x509.Certificate, extension: type[x509.ExtensionType]) -> bool:
    try:
        own.extensions.get_extension_for_class(extension)
    except ExtensionNotFound:
        return False
    return True


def test_robots_keep_what_they_have(stages: Stages) -> None:
    before = files(stages.folder / "sros2")
    assert len(before) == 2 * 7 + 2 + 3
    assert files(stages.folder / "adopted") == before


def test_each_step_hardens_what_it_says(stages: Stages) -> None:
    enclaves = {step: stages(step, "/talker") for step in STEPS}
    assert {(enclaves["sros2"] / "key.pem").stat().st_mode & 0o077} == {0o044}
    assert not any((enclaves[step] / "key.pem").stat().st_mode & 0o077 for step in STEPS[1:])
    names = {step: certificate(enclaves[step] / "cert.pem").subject.rfc4514_string() for step in STEPS}
    assert names["adopted"] == "CN=/talker"
    assert names["one name"].startswith("CN=/talker,OU=")
    assert certificate(stages("one name", "/listener") / "cert.pem").subject.rfc4514_string() == "CN=/listener"
    assert [step for step in STEPS if not same_authority(enclaves[step])] == ["authority", "identifiers"]
    own, authority = (certificate(enclaves["identifiers"] / name) for name in ("cert.pem", "identity_ca.cert.pem"))
    assert has(authority, SubjectKeyIdentifier)
    assert has(own, AuthorityKeyIdentifier)
    earlier = certificate(enclaves["authority"] / "identity_ca.cert.pem")
    assert not has(earlier, SubjectKeyIdentifier)
    assert authority.public_key() == earlier.public_key()


def same_authority(enclave: Path) -> bool:
    return (enclave / "identity_ca.cert.pem").read_bytes() == (enclave / "permissions_ca.cert.pem").read_bytes()


@pytest.mark.parametrize("step", STEPS)
def test_talker_and_listener_exchange_after_each_step(stages: Stages, system: System, step: str) -> None:
    assert hears(system, stages(step, "/listener"), stages(step, "/talker"))


@pytest.mark.parametrize(("listener", "talker"), [("sros2", "names"), ("names", "sros2"), ("authority", "identifiers")])
def test_these_steps_are_deployed_enclave_by_enclave(
    stages: Stages, system: System, listener: str, talker: str
) -> None:
    assert hears(system, stages(listener, "/listener"), stages(talker, "/talker"))


def test_a_second_authority_is_a_flag_day(stages: Stages, system: System) -> None:
    assert not hears(system, stages("names", "/listener"), stages("authority", "/talker"))
