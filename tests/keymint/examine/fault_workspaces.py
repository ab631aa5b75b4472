# SPDX-License-Identifier: Apache-2.0
"""The kinds of workspaces that faults are injected into, each made once, and copied for each fault."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from cryptography import x509

from tests import sros2_keystore
from tests.sros2_keystore import Form

from .fault_keystores import DAY, SUBJECTS, Keystore, Run, public

POLICY = """<profiles>
  <profile name="talker"><attachment>/talker</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="DENY"><attachment>/status/secret</attachment><permissions><ros_publish/></permissions>
    </ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/status/*</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/tf</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions></ros_topic>
  </profile>
  <profile name="listener"><attachment>/robot1/listener</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_subscribe/></permissions>
    </ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/status/ok</attachment><permissions><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
  <profile name="robot1"><attachment>/robot1</attachment>
    <ros_service qualifier="ALLOW"><attachment>/add</attachment><permissions><ros_call/></permissions></ros_service>
    <ros_topic qualifier="ALLOW"><attachment>/cmd</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="camera"><attachment>/robot1/camera</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/image*</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/tf</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
  <profile name="planner"><attachment>/planner</attachment>
    <ros_service qualifier="ALLOW"><attachment>/add</attachment><permissions><ros_execute/></permissions></ros_service>
    <ros_topic qualifier="ALLOW"><attachment>/image</attachment><permissions><ros_subscribe/></permissions></ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/cmd</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
</profiles>
"""
WIDER = POLICY.replace("/chatter<", "/chatter*<").replace("/add<", "/add*<").replace("/image*<", "/*<")
"""The same policy with more rights for each subject."""
SROS2_POLICY = """<policy version="0.2.0"><enclaves>
  <enclave path="/talker"><profiles><profile ns="/" node="talker">
    <topics publish="ALLOW"><topic>chatter</topic><topic>status</topic></topics></profile></profiles></enclave>
  <enclave path="/listener"><profiles><profile ns="/" node="listener">
    <topics subscribe="ALLOW"><topic>chatter</topic></topics></profile></profiles></enclave>
  <enclave path="/camera"><profiles><profile ns="/" node="camera">
    <topics publish="ALLOW"><topic>image</topic></topics></profile></profiles></enclave>
  <enclave path="/planner"><profiles><profile ns="/" node="planner">
    <topics subscribe="ALLOW"><topic>image</topic></topics>
    <services request="ALLOW"><service>add</service></services></profile></profiles></enclave>
</enclaves></policy>"""


@dataclass(frozen=True)
class Bench:
    """Makes workspaces of a kind once, and a new copy of one at the same path for each fault.

    Attributes:
        folder: where.
        run: runs the command line.
        now: its clock.
    """

    folder: Path
    run: Run
    now: datetime

    def copy(self, kind: str) -> Keystore:
        """Return a workspace as it was made."""
        place, original = self.folder / kind, self.folder / "originals" / kind
        if not original.exists():
            place.mkdir(parents=True)
            (place / "policy.xml").write_text(POLICY)
            MAKERS[kind](self, place)
            shutil.copytree(place, original, symlinks=True)
        shutil.rmtree(place, onerror=_writable)
        shutil.copytree(original, place, symlinks=True)
        return Keystore(place / "ws", self.now, self.run)

    def do(self, place: Path, *words: object) -> None:
        code = self.run(*words, "-w", place / "ws", "-q")
        assert code == 0, (words, code)

    def keep(self, place: Path, number: int) -> None:
        shutil.copytree(place / "ws/install", place / "stages" / str(number), symlinks=True)


def _writable(function: Callable[[str], object], path: str, _: object) -> None:
    Path(path).parent.chmod(0o700)
    Path(path).chmod(0o700)
    function(path)


def _provision(bench: Bench, place: Path, *words: object) -> None:
    bench.do(place, "provision", place / "policy.xml", *words)


def _provision_plain(bench: Bench, place: Path) -> None:
    """Names without generations, as SROS2 gives them; no name contains another."""
    (place / "policy.xml").write_text(
        POLICY.replace("<attachment>/robot1</attachment>", "<attachment>/arm</attachment>")
    )
    _provision(bench, place, "--subject-format", "sros2")


def _generations(bench: Bench, place: Path) -> None:
    """Each enclave has its third generation; the earlier ones are revoked."""
    _provision(bench, place)
    for number in range(2):
        bench.keep(place, number)
        bench.do(place, "revoke", *(each[1:] for each in SUBJECTS), "--reason", "superseded")
    bench.keep(place, 2)


def _narrowed(bench: Bench, place: Path) -> None:
    """The policy allowed more; documents of that time fit the certificates of today."""
    (place / "policy.xml").write_text(WIDER)
    _provision(bench, place)
    bench.keep(place, 0)
    (place / "policy.xml").write_text(POLICY)
    _provision(bench, place, "--yes")


def _revoked(bench: Bench, place: Path) -> None:
    """The camera was stolen; later two more certificates were superseded."""
    _provision(bench, place)
    bench.keep(place, 0)
    bench.do(place, "revoke", "robot1/camera", "--reason", "key-compromise")
    bench.keep(place, 1)
    bench.do(place, "revoke", "planner", "--reason", "superseded")
    bench.keep(place, 2)
    bench.do(place, "revoke", "talker", "--reason", "superseded")
    bench.keep(place, 3)
    bench.do(place, "crl", "--refresh")
    bench.keep(place, 4)


def _rollover(*phases: Sequence[str]) -> Callable[[Bench, Path], None]:
    def make(bench: Bench, place: Path) -> None:
        _provision(bench, place)
        bench.keep(place, 0)
        for words in phases:
            bench.do(place, "authority", "replace", *words)

    return make


def _adopted(bench: Bench, place: Path) -> None:
    sros2_keystore.make(place / "ks", SROS2_POLICY, Form(now=bench.now - DAY))
    for path in (place / "ks").rglob("*.pem"):
        path.chmod(0o600 if "key" in path.name else 0o644)
    (place / "policy.xml").write_text(SROS2_POLICY)
    bench.do(place, "adopt", place / "ks", place / "policy.xml", "--apply")


def _requested(bench: Bench, place: Path) -> None:
    """Robots made their keys: each is in ``robot/``, and none in the workspace."""
    _provision(bench, place)
    for subject in SUBJECTS:
        file = place / f"{subject[1:].replace('/', '.')}.request.pem"
        assert bench.run("request", subject, "--folder", place / "robot", "-o", file, "-q") == 0
        key = x509.load_pem_x509_csr(file.read_bytes()).public_key()
        fingerprint = hashlib.sha256(public(key)).hexdigest()
        bench.do(place, "sign", file, "--fingerprint", f"{subject}={fingerprint}", "-o", place)
        (place / f"ws/private/identities{subject}/key.pem").unlink()


def _zenoh_revoked(bench: Bench, place: Path) -> None:
    """The camera was stolen; routers know its name no longer."""
    _provision(bench, place, "--transport", "zenoh")
    bench.keep(place, 0)
    bench.do(place, "revoke", "robot1/camera", "--reason", "key-compromise")
    bench.keep(place, 1)
    bench.do(place, "revoke", "planner", "--reason", "superseded")


IDENTITY, PERMISSIONS = "identity_ca", "permissions_ca"
MAKERS: Mapping[str, Callable[[Bench, Path], None]] = {
    "dds": _provision,
    "plain names": _provision_plain,
    "generations": _generations,
    "narrowed": _narrowed,
    "revoked": _revoked,
    "staged identity": _rollover([IDENTITY]),
    "staged permissions": _rollover([PERMISSIONS]),
    "distributed": _rollover([IDENTITY, "--vendor", "fastdds"]),
    "reissued": _rollover([IDENTITY, "--vendor", "fastdds"], [IDENTITY, "--phase", "reissue"]),
    "ended": _rollover([IDENTITY], [IDENTITY, "--phase", "end"]),
    "adopted": _adopted,
    "zenoh": lambda bench, place: _provision(bench, place, "--transport", "zenoh"),
    "zenoh revoked": _zenoh_revoked,
    "requested": _requested,
    "both": lambda bench, place: _provision(bench, place, "--transport", "dds", "--transport", "zenoh"),
}
"""How the workspaces of each kind are made."""
