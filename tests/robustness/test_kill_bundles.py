# SPDX-License-Identifier: Apache-2.0
"""Robots and authorities killed at any call while keys travel: no key is lost, no enclave torn, no number given twice.

With ``KEYMINT_FULL=1`` every call that may change a file is struck in turn, otherwise a sample of them.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from comarmor.errors import Origin
from keymint.life.register import loaded_register
from keymint.pki import keys
from keymint.robots import bundle, certification_request as request
from tests.effort import FULL

from . import scenarios, tracing
from .test_kill import IN_ORDER, chosen
from .tracing import Ended, Point

pytestmark = pytest.mark.strace

Keymint = Callable[..., Any]
Files = Mapping[str, bytes]
WHERE = Origin("test")
NONCE = "0123456789abcdef" * 2


@pytest.fixture(autouse=True)
def strace(plain_environment: None) -> None:
    tracing.require_strace()


def files(folder: Path) -> dict[str, bytes]:
    """Return the visible files below a folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".keymint-") for part in relative.parts):
            found[str(relative)] = path.read_bytes()
    return found


def left(folder: Path) -> dict[str, str]:
    """Return all paths with their modes, temporary ones included, but for those in a folder of the user's."""
    return {path: mode for path, mode in scenarios.tree(folder).items() if not path.startswith(".keymint-")}


def done(keymint: Keymint, *arguments: object) -> dict[str, Any]:
    outcome = keymint(*arguments, "--json")
    assert outcome.code == 0, outcome.out + outcome.err
    result: dict[str, Any] = outcome.document["result"]
    return result


@dataclass(frozen=True)
class Struck:
    """A run to kill in copies of a folder.

    Attributes:
        start: the folder in which the runs start.
        arguments: the command line; ``{}`` stands for the folder.
        end: the files after an undisturbed run.
    """

    start: Path
    arguments: tuple[str, ...]
    end: Files

    def line(self, folder: Path) -> list[str]:
        return [argument.format(folder) for argument in self.arguments]


def killed(ended: Ended) -> None:
    assert ended.code == -9


def refused(ended: Ended) -> None:
    assert ended.code == 1
    [line] = ended.output.strip().splitlines()
    assert "No space left on device" in line
    assert "internal error" not in line


def strike(
    start: Path,
    arguments: tuple[str, ...],
    memory: Path,
    keymint: Keymint,
    check: Callable[[Struck, Path], None],
    how: str = "signal=SIGKILL",
) -> None:
    """Strike a run at each of its calls; check what is there, run again, and compare with an undisturbed run."""
    undisturbed = memory / "undisturbed"
    shutil.copytree(start, undisturbed)
    plain = [argument.format(undisturbed) for argument in arguments]
    traced = tracing.trace(plain, undisturbed, memory)
    assert traced.ended.code == 0, traced.ended.output
    assert {"renameat", "fsync", "write", "openat"} <= {point.call for point in traced.points}
    struck = Struck(start, arguments, files(undisturbed))
    # A folder that cannot be made is tried again, and one that stays is no failure.
    asked = [point for point in traced.points if "SIGKILL" in how or point.call not in {"mkdir", "mkdirat", "rmdir"}]
    points = chosen(asked, IN_ORDER // 2)
    converged: set[frozenset[tuple[str, bool]]] = set()
    before = files(start)
    copies = [memory / f"copy-{number}" for number in range(len(points))]
    for copy in copies:
        shutil.copytree(start, copy)
    jobs: list[tuple[Point, list[str]]] = [
        (point, struck.line(copy)) for point, copy in zip(points, copies, strict=True)
    ]
    ended: list[Ended] = tracing.strike(how, jobs, traced, memory)
    for (point, line), copy, end in zip(jobs, copies, ended, strict=True):
        try:
            (killed if "SIGKILL" in how else refused)(end)
            check(struck, copy)
            now = files(copy)
            look = frozenset((path, content == before.get(path)) for path, content in now.items())
            if look in converged and not FULL:
                continue
            converged.add(look)
            again = keymint(*line)
            assert again.code == 0, again.err
            check(struck, copy)
            assert set(files(copy)) == set(struck.end)
            assert left(copy) == left(undisturbed)
        except Exception as error:
            error.add_note(f"struck at {point}\n{end.output}")
            raise
        finally:
            shutil.rmtree(copy)


# -- the robot asks --------------------------------------------------------------------------------------------------


def test_a_request_never_leaves_without_its_key(memory: Path, keymint: Keymint) -> None:
    start = memory / "start"
    start.mkdir()
    seen: dict[Path, str] = {}

    def check(_: Struck, folder: Path) -> None:
        written, waiting = folder / "talker.request.pem", folder / "ks/.keymint/requests/talker"
        if waiting.exists():
            key = load_pem_private_key((waiting / "key.pem").read_bytes(), None)
            assert isinstance(key, ec.EllipticCurvePrivateKey)
            kept = request.read((waiting / "request.pem").read_bytes(), WHERE)
            assert kept.fingerprint == keys.fingerprint(key)
            assert seen.setdefault(folder, kept.fingerprint) == kept.fingerprint  # the next run makes no other key
            assert (waiting / "key.pem").stat().st_mode & 0o077 == 0
        if written.exists():
            assert written.read_bytes() == (waiting / "request.pem").read_bytes()

    arguments = ("request", "talker", "--folder", "{}/ks", "-o", "{}/talker.request.pem")
    strike(start, arguments, memory, keymint, check)
    assert seen


# -- the authority signs ---------------------------------------------------------------------------------------------


@pytest.fixture
def workspace(memory: Path, keymint: Keymint) -> Path:
    """A folder with a workspace, and a request of a robot for one of its enclaves."""
    start = memory / "start"
    start.mkdir()
    (start / "policy.xml").write_text(scenarios.policy("/robot/talker", "/listener"))
    assert keymint("provision", start / "policy.xml", "-w", start / "ws").code == 0
    (start / "r.pem").write_bytes(request.make("/listener", KEY, NONCE))
    (start / "ws/private/identities/listener/key.pem").unlink()  # the robot's own takes its place
    return start


KEY = ec.derive_private_key(20_261_122, ec.SECP256R1())
CONFIRMED = f"/listener={keys.fingerprint(KEY)}"


def test_no_serial_and_no_number_is_given_twice(workspace: Path, memory: Path, keymint: Keymint) -> None:
    written: dict[Path, bundle.Bundle] = {}

    def check(_: Struck, folder: Path) -> None:
        scenarios.require_whole_files(folder / "ws")
        register = loaded_register((folder / "ws/private/register.sqlite3").read_bytes(), WHERE)
        serials = {serial: each for (_, serial), each in register.certificates.items()}
        assert len(serials) == len(register.certificates)
        for path in (folder / "ws/install/enclaves").rglob("cert.pem"):
            if ".keymint-" not in str(path):
                certificate = x509.load_pem_x509_certificate(path.read_bytes())
                assert serials[certificate.serial_number].name == str(
                    path.parent.relative_to(folder / "ws/install/enclaves")
                )
        if (folder / "out.bundle").exists():
            made = bundle.read((folder / "out.bundle").read_bytes(), WHERE)
            assert register.bundles["listener"] >= made.manifest.issue
            before = written.setdefault(folder, made)
            assert made is before or made.manifest.issue > before.manifest.issue

    arguments = ("sign", "{}/r.pem", "-w", "{}/ws", "--fingerprint", CONFIRMED, "-o", "{}/out.bundle")
    strike(workspace, arguments, memory, keymint, check)
    assert written


# -- the robot takes it ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Robot:
    """A folder with a keystore and a bundle, and the fingerprint of the authority."""

    folder: Path
    trust: str


KILLED, FULL_DISK = "signal=SIGKILL", "error=ENOSPC"
CASES = [(robot, how) for robot in ("first", "another key", "another policy") for how in (KILLED, FULL_DISK)]
SAMPLE = [("first", KILLED), ("another key", KILLED), ("another key", FULL_DISK)]


@pytest.fixture
def robot(request: pytest.FixtureRequest, memory: Path, keymint: Keymint) -> Robot:
    """A robot that takes its first bundle, one for a new key, or one with other rights."""
    start, ws = memory / "start", memory / "ws"
    start.mkdir()
    (memory / "policy.xml").write_text(scenarios.policy("/robot/talker"))
    assert keymint("provision", memory / "policy.xml", "-w", ws).code == 0
    ask = ("request", "/robot/talker", "--folder", start / "ks", "-o", memory / "r.pem")

    def signed(*more: str) -> str:
        fingerprint = done(keymint, *ask, *more)["fingerprint"]
        made = done(
            keymint, "sign", memory / "r.pem", "-w", ws, "--fingerprint", f"/robot/talker={fingerprint}",
            "-o", start / "talker.bundle",
        )  # fmt: skip
        trust: str = made["bundles"][0]["authority"]
        return trust

    trust = signed()
    if request.param == "first":
        return Robot(start, trust)
    done(keymint, "accept", start / "talker.bundle", "--folder", start / "ks", "--authority-fingerprint", trust)
    if request.param == "another key":
        signed("--rekey")
        return Robot(start, trust)
    (memory / "policy.xml").write_text(scenarios.policy("/robot/talker", version="_changed"))
    assert keymint("provision", memory / "policy.xml", "-w", ws).code == 0
    done(keymint, "bundle", "/robot/talker", "-w", ws, "-o", start / "talker.bundle")
    return Robot(start, trust)


@pytest.mark.parametrize(("robot", "how"), CASES if FULL else SAMPLE, indirect=["robot"])
def test_an_enclave_is_old_or_new_and_its_key_is_never_lost(
    robot: Robot, how: str, memory: Path, keymint: Keymint
) -> None:
    folder = "ks/enclaves/robot/talker"
    old = files(robot.folder / folder)
    wanted = bundle.read((robot.folder / "talker.bundle").read_bytes(), WHERE).manifest

    def check(struck: Struck, copy: Path) -> None:
        now = files(copy / folder)
        new = {path.removeprefix(f"{folder}/"): data for path, data in struck.end.items() if path.startswith(folder)}
        assert now in (old, new)
        if now:
            scenarios.require_fitting(now)
            assert (copy / folder / "key.pem").stat().st_mode & 0o077 == 0
        pending = files(copy / "ks/.keymint/requests/robot/talker")
        there = [data for data in (now.get("key.pem"), pending.get("key.pem")) if data]
        assert wanted.key in {keys.fingerprint(keys.from_pem(pem)) for pem in there}

    trusting = ("--folder", "{}/ks", "--authority-fingerprint", robot.trust)
    strike(robot.folder, ("accept", "{}/talker.bundle", *trusting), memory, keymint, check, how)
