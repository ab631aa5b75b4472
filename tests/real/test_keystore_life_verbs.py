# SPDX-License-Identifier: Apache-2.0
"""Keystores that the verbs change, in real participants: who is refused, by whom, and who need not restart.

Every refusal has a control with the same files but for the defence.
"""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.participants import RefusedError, System, Vendor

from tests.softhsm import PIN, opened

from .conftest import on_each_fastdds
from .presenters import presenting
from .probe_commands import await_rejection
from .provisioning import enclave, keymint, provision
from .stages import POLICY, WAIT, Stages, hears

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.xdist_group("keystores in stages")
WIDE = POLICY.split('<ros_topic qualifier="ALLOW"><attachment>/wide', 1)
NARROW = WIDE[0] + WIDE[1].split("</ros_topic>\n", 1)[1]


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Stages:
    """Provision; revoke /stolen; take a right from /talker and supersede it."""
    folder = tmp_path_factory.mktemp("life")
    install = provision(POLICY, folder)
    workspace = install.parent

    def keep(stage: str) -> None:
        shutil.copytree(install, folder / "stages" / stage)

    keep("first")
    keymint("revoke", "stolen", "--reason", "key-compromise", "-w", workspace)
    keep("stolen")
    (folder / "policy.xml").write_text(NARROW)
    provision(folder / "policy.xml", folder)
    keymint("revoke", "talker", "--reason", "superseded", "-w", workspace)
    keep("narrow")
    return Stages(folder / "stages", workspace)


def test_a_revoked_peer_is_refused_and_the_others_go_on(stages: Stages, system: System) -> None:
    informed = system.open(stages("stolen", "/listener")).edge("subscribe", "rt/x")
    trusting = system.open(stages("first", "/listener")).edge("subscribe", "rt/x")
    system.open(stages("first", "/stolen")).edge("publish", "rt/x").write("from the thief")
    assert await_rejection(informed, WAIT)
    assert trusting.read(WAIT) == "from the thief"
    system.open(stages("stolen", "/talker")).edge("publish", "rt/x").write("from the talker")
    assert (informed.read(WAIT), trusting.read(WAIT)) == ("from the talker", "from the talker")


def test_nothing_is_issued_for_a_key_that_was_stolen(stages: Stages) -> None:
    assert stages("first", "/stolen").is_dir()
    assert not stages("stolen", "/stolen").exists()


def test_old_permissions_with_the_old_certificate_are_refused_by_whoever_has_the_new_list(
    stages: Stages, system: System
) -> None:
    informed = system.open(stages("narrow", "/listener")).edge("subscribe", "rt/wide")
    trusting = system.open(stages("stolen", "/listener")).edge("subscribe", "rt/wide")
    system.open(stages("first", "/talker")).edge("publish", "rt/wide").write("as long as I may")
    assert await_rejection(informed, WAIT)
    assert trusting.read(WAIT) == "as long as I may"


@pytest.mark.parametrize("document", ["first", "narrow"])
def test_old_permissions_with_the_new_certificate_are_refused_by_everybody(
    stages: Stages, vendor: Vendor, probe_cache: Path, document: str
) -> None:
    """Also by a peer without any list. The control presents the new permissions in the same way."""
    presented = stages(document, "/talker") / "permissions.p7s"
    with System(presenting(vendor, probe_cache, presented)) as system:
        listener = system.open(stages("first", "/listener")).edge("subscribe", "rt/x")
        system.open(stages("narrow", "/talker"), conforming=False).edge("publish", "rt/x").write("hello")
        if document == "first":
            assert await_rejection(listener, WAIT)
        else:
            assert listener.read(WAIT) == "hello"


def test_a_mixture_of_generations_is_no_participant(stages: Stages, system: System, tmp_path: Path) -> None:
    mixed = shutil.copytree(stages("narrow", "/talker"), tmp_path / "mixed")
    shutil.copy(stages("first", "/talker") / "permissions.p7s", mixed)
    with pytest.raises(RefusedError):
        system.open(mixed)


def moved(stages: Stages, folder: Path) -> Path:
    """Return a copy of the workspace in a folder of its own."""
    workspace = shutil.copytree(stages.workspace, folder / "ws")
    shutil.copy(stages.workspace.parent / "policy.xml", folder)
    return workspace


@pytest.fixture(scope="module")
def in_token(stages: Stages, tmp_path_factory: pytest.TempPathFactory) -> Stages:
    """Move the keys of both authorities into a token, and supersede /talker once more."""
    folder = tmp_path_factory.mktemp("token")
    softhsm = opened(folder / "softhsm")
    workspace = moved(stages, folder)
    profile = workspace / "profile/authorities.xml"
    text = profile.read_text()
    for number, name in enumerate(("identity_ca", "permissions_ca"), start=1):
        file = workspace / f"private/{name}.key.pem"
        uri = softhsm.import_key(file, name, f"{number:02}")
        file.unlink()
        text = text.replace(
            f'<authority name="{name}">', f'<authority name="{name}">\n<key><pkcs11>{uri}</pkcs11></key>'
        )
    profile.write_text(text)
    environment = {**softhsm.environment, "KEYMINT_PKCS11_PIN": PIN}
    keymint("revoke", "talker", "--reason", "superseded", "-w", workspace, environment=environment)
    shutil.copytree(workspace / "install", folder / "stages/token")
    return Stages(folder / "stages", workspace)


@pytest.mark.softhsm
def test_what_a_token_signs(stages: Stages, in_token: Stages, system: System) -> None:
    """Certificate, permissions and revocation list; the listener's other files are from before."""
    listener = in_token("token", "/listener")
    unchanged = {"cert.pem", "key.pem", "permissions.p7s", "identity_ca.cert.pem", "permissions_ca.cert.pem"}
    assert all(
        (listener / name).read_bytes() == (stages("narrow", "/listener") / name).read_bytes() for name in unchanged
    )
    reader = system.open(listener).edge("subscribe", "rt/x")
    system.open(stages("narrow", "/talker")).edge("publish", "rt/x").write("superseded")
    assert await_rejection(reader, WAIT)
    system.open(in_token("token", "/talker")).edge("publish", "rt/x").write("hello")
    assert reader.read(WAIT) == "hello"


@pytest.fixture(scope="module")
def bundles(stages: Stages, tmp_path_factory: pytest.TempPathFactory) -> Stages:
    """Replace the key of the identity authority where vendors trust two at once, phase by phase."""
    folder = tmp_path_factory.mktemp("bundles")
    workspace = moved(stages, folder)
    replacing = ("authority", "replace", "identity_ca", "-w", workspace)
    steps = ("both", ("--vendor", "fastdds")), ("issued", ("--phase", "reissue")), ("alone", ("--phase", "end"))
    for phase, options in steps:
        keymint(*replacing, *options)
        shutil.copytree(workspace / "install", folder / "stages" / phase)
    shutil.copytree(stages.folder / "narrow", folder / "stages/before")
    shutil.copytree(stages.folder / "first", folder / "stages/first")
    return Stages(folder / "stages", workspace)


@on_each_fastdds
def test_each_phase_of_a_rollover_works_with_the_ones_beside_it(bundles: Stages, vendor: Vendor) -> None:
    """Robots follow one by one; the control are robots that are two phases apart."""
    beside = [
        ("before", "both"),
        ("both", "before"),
        ("both", "issued"),
        ("issued", "both"),
        ("issued", "alone"),
        ("alone", "issued"),
    ]
    apart = [("before", "issued"), ("alone", "both")]
    for pairs, expected in ((beside, True), (apart, False)):
        for listener, talker in pairs:
            with System(vendor) as system:
                heard = hears(system, bundles(listener, "/listener"), bundles(talker, "/talker"))
                assert heard == expected, (listener, talker)


@on_each_fastdds
@pytest.mark.parametrize("phase", ["both", "issued", "alone"])
def test_in_each_phase_the_revoked_ones_stay_refused(bundles: Stages, vendor: Vendor, phase: str) -> None:
    with System(vendor) as system:
        reader = system.open(bundles(phase, "/listener")).edge("subscribe", "rt/x")
        system.open(bundles("first", "/stolen")).edge("publish", "rt/x").write("from the thief")
        assert await_rejection(reader, WAIT)
        system.open(bundles(phase, "/talker")).edge("publish", "rt/x").write("from the talker")
        assert reader.read(WAIT) == "from the talker"


@pytest.fixture(scope="module")
def second_keystore(stages: Stages, tmp_path_factory: pytest.TempPathFactory) -> Stages:
    """Replace the key of the identity authority where all robots switch at once."""
    folder = tmp_path_factory.mktemp("second")
    workspace = moved(stages, folder)
    keymint("authority", "replace", "identity_ca", "-w", workspace)
    for name, source in (("present", "install"), ("next", "install.next")):
        shutil.copytree(workspace / source, folder / "stages" / name)
    keymint("authority", "replace", "identity_ca", "--phase", "end", "-w", workspace)
    shutil.copytree(workspace / "install", folder / "stages/done")
    return Stages(folder / "stages", workspace)


def test_a_second_keystore_is_complete_and_the_two_do_not_mix(second_keystore: Stages, vendor: Vendor) -> None:
    pairs = {
        ("present", "present"): True, ("next", "next"): True, ("done", "next"): True, ("next", "done"): True,
        ("present", "next"): False, ("next", "present"): False,
    }  # fmt: skip
    for (listener, talker), expected in pairs.items():
        with System(vendor) as system:
            heard = hears(system, second_keystore(listener, "/listener"), second_keystore(talker, "/talker"))
            assert heard == expected, (listener, talker)


@pytest.fixture(scope="module")
def by_request(stages: Stages, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Let a robot make the key of /talker, and take what the authority answers; return the robot's keystore."""
    folder = tmp_path_factory.mktemp("request")
    workspace, robot, usb = moved(stages, folder), folder / "robot", folder / "usb"
    usb.mkdir()
    asked = json.loads(keymint("request", "/talker", "--folder", robot, "-o", usb / "request.pem", "--json"))
    fingerprint = asked["result"]["fingerprint"]
    keymint(
        "sign", usb / "request.pem", "--fingerprint", f"/talker={fingerprint}", "-o", usb / "bundle", "-w", workspace
    )
    shown = json.loads(keymint("authority", "show", "identity_ca", "--json", "-w", workspace))
    (authority,) = shown["result"]["authorities"]
    keymint(
        "accept", usb / "bundle", "--folder", robot, "--authority-fingerprint", authority["certificate"]["fingerprint"]
    )
    assert not enclave(workspace / "install", "/talker").joinpath("key.pem").exists()
    return robot


def test_an_enclave_made_by_request(stages: Stages, by_request: Path, system: System) -> None:
    reader = system.open(stages("narrow", "/listener")).edge("subscribe", "rt/x")
    system.open(enclave(by_request, "/talker")).edge("publish", "rt/x").write("from its own key")
    assert reader.read(WAIT) == "from its own key"
