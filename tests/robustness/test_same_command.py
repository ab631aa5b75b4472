# SPDX-License-Identifier: Apache-2.0
"""A command that was killed, or that the system refused a write, is finished by the same command.

Each verb that writes is struck at its calls that change files: killed, or refused with ENOSPC, EIO or EDQUOT. Then the
same command is given once more. With ``KEYMINT_FULL=1`` every call is struck in each way, otherwise a sample of them.
"""

from __future__ import annotations

import filecmp
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from comarmor.errors import Origin
from keymint.life.register import loaded_register
from keymint.pki import certificates, keys
from keymint.robots import bundle, certification_request
from tests import sros2_keystore
from tests.effort import FULL
from tests.keymint.commands.life.test_authority import outside

from . import scenarios, tracing
from .test_kill import CRITICAL
from .tracing import Ended, Point

pytestmark = pytest.mark.strace

Keymint = Callable[..., Any]
KILLED = "signal=SIGKILL"
ERRORS = ("error=ENOSPC", "error=EIO", "error=EDQUOT")
KEY = ec.derive_private_key(20_261_124, ec.SECP256R1())
OF_SROS2 = """<policy version="0.2.0"><enclaves>
  <enclave path="/talker"><profiles><profile ns="/" node="talker">
    <topics publish="ALLOW"><topic>chatter</topic></topics>
  </profile></profiles></enclave>
</enclaves></policy>"""


@pytest.fixture(autouse=True)
def strace(plain_environment: None) -> None:
    tracing.require_strace()


@dataclass(frozen=True)
class Struck:
    """A command to strike.

    Attributes:
        verb: its command line; ``{}`` stands for the folder.
        before: the commands that come before it, and functions of the folder.
        code: its exit code.
        checked: ``keymint check`` has no findings after it; else it says what it says after an undisturbed run.
    """

    verb: str
    before: tuple[str | Callable[[Path], object], ...] = ()
    code: int = 0
    checked: bool = True

    def line(self, folder: Path) -> list[str]:
        return words(self.verb, folder)


def words(line: str, folder: Path) -> list[str]:
    """Return a command line; ``{trust}`` stands for the fingerprint of the authority that signs bundles."""
    authority = folder / "ws/public/identity_ca.cert.pem"
    trust = certificates.fingerprint(certificates.load(authority.read_bytes())) if authority.exists() else ""
    return [word.format(folder, trust=trust) for word in line.split()]


def older(folder: Path) -> None:
    for name in ("identities", "permissions"):
        defaults = folder / f"ws/profile/package.defaults/{name}.xml"
        defaults.write_text(defaults.read_text().replace("<not_before>2027-01-14T", "<not_before>2026-10-14T"))


def badly_formatted(folder: Path) -> None:
    path = folder / "policy.xml"
    path.write_text(path.read_text().replace("<profile ", "<profile     "))


def narrower(folder: Path) -> None:
    path = folder / "policy.xml"
    path.write_text(path.read_text().replace("/chatter", "/chat"))


def without_listener(folder: Path) -> None:
    (folder / "policy.xml").write_text(scenarios.policy("/robot/talker"))
    shutil.rmtree(folder / "ws/src/listener")


def renamed(folder: Path) -> None:
    (folder / "policy.xml").write_text(scenarios.policy("/robot/talker", "/hearer"))


def asked(folder: Path) -> None:
    (folder / "r.pem").write_bytes(certification_request.make("/listener", KEY, "0123456789abcdef" * 2))
    (folder / "ws/private/identities/listener/key.pem").unlink()  # the robot's own takes its place


def from_elsewhere(folder: Path) -> None:
    certificate, key = outside()
    (folder / "ca.pem").write_bytes(certificate)
    (folder / "ca.key").write_bytes(key)


def of_another_tool(folder: Path) -> None:
    sros2_keystore.make(folder / "ks", OF_SROS2)
    for path in (folder / "ks").rglob("*.pem"):
        path.chmod(0o600 if "key" in path.name else 0o644)
    (folder / "sros2.xml").write_text(OF_SROS2)


WS = " -w {}/ws"
PROVISION = "provision {}/policy.xml -j 1" + WS
ADOPT = "adopt {}/ks {}/sros2.xml --apply" + WS
GIVEN_UP = "revoke listener --reason key-compromise" + WS
ASK = "request listener --folder {}/ks -o {}/r.pem"
ACCEPT = "accept {}/b --folder {}/ks --new --authority-fingerprint {trust}"
REPLACE = "authority replace identity_ca" + WS
BY_BUNDLES = f"{REPLACE} --vendor fastdds"
SIGN = f"sign {{}}/r.pem --fingerprint /listener={keys.fingerprint(KEY)} -o {{}}/out.bundle" + WS
AUTHORITY, IDENTIFIERS, NAMES = (
    f"harden {step} --apply {flag}" + WS
    for step, flag in (("authority", "--flag-day"), ("identifiers", "--flag-day"), ("names", ""))
)

COMMANDS: Mapping[str, Struck] = {
    "rekey of a revoked enclave": Struck("renew --rekey listener" + WS, (PROVISION, GIVEN_UP)),
    "revoke superseded rights": Struck(f"{PROVISION} --revoke-superseded", (PROVISION, narrower)),
    "harden authority": Struck(AUTHORITY, (of_another_tool, ADOPT), checked=False),
    "harden identifiers": Struck(IDENTIFIERS, (of_another_tool, ADOPT, AUTHORITY), checked=False),
    "harden names": Struck(NAMES, (of_another_tool, ADOPT, AUTHORITY, IDENTIFIERS), checked=False),
    "adopt": Struck(ADOPT, (of_another_tool,), checked=False),
    "export": Struck("authority export identity_ca -o {}/c.pem --with-key {}/k.pem" + WS, (PROVISION,)),
    "bundle": Struck("bundle listener -o {}/out.bundle" + WS, (PROVISION,)),
    "renew while staged": Struck("renew listener" + WS, (PROVISION, older, PROVISION, REPLACE)),
    "provision": Struck(PROVISION),
    "provision a change": Struck(PROVISION, (PROVISION, narrower)),
    "provision strictly": Struck(f"{PROVISION} --strict", (PROVISION, narrower)),
    "prune": Struck(f"{PROVISION} --prune", (PROVISION, without_listener)),
    "new keys": Struck(f"{PROVISION} --rekey=* --yes", (PROVISION,)),
    "create": Struck("create --all" + WS, (PROVISION, narrower), checked=False),
    "build": Struck("build -j 1" + WS, (PROVISION, narrower, "create --all" + WS), checked=False),
    "install": Struck("install -j 1" + WS, (PROVISION, narrower, "create --all" + WS, "build" + WS)),
    "renew": Struck("renew listener" + WS, (PROVISION, older, PROVISION)),
    "rekey": Struck("renew --rekey listener" + WS, (PROVISION,)),
    "revoke": Struck("revoke listener --reason superseded" + WS, (PROVISION,)),
    "retire": Struck("revoke listener --reason retired" + WS, (PROVISION,)),
    "remove": Struck("remove listener" + WS, (PROVISION, renamed)),
    "set": Struck("set domain 5" + WS, (PROVISION,), checked=False),
    "crl": Struck("crl --refresh" + WS, (PROVISION, GIVEN_UP)),
    "sign": Struck(SIGN, (PROVISION, asked)),
    "renew authority": Struck("authority renew identity_ca --flag-day" + WS, (PROVISION,)),
    "distribute": Struck(BY_BUNDLES, (PROVISION,)),
    "reissue": Struck(f"{REPLACE} --phase reissue", (PROVISION, BY_BUNDLES)),
    "end": Struck(f"{REPLACE} --phase end", (PROVISION, BY_BUNDLES, f"{REPLACE} --phase reissue")),
    "stage": Struck(REPLACE, (PROVISION,)),
    "exchange": Struck(f"{REPLACE} --phase end", (PROVISION, REPLACE)),
    "cancel": Struck(f"{REPLACE} --cancel", (PROVISION, REPLACE)),
    "init": Struck("init {}/ws", checked=False),
    "import authority": Struck(
        "authority import identity_ca {}/ca.pem --key {}/ca.key" + WS, ("init {}/ws", from_elsewhere), checked=False
    ),
    "request": Struck(ASK),
    "rekey by request": Struck(f"{ASK} --rekey", (PROVISION, "bundle listener -o {}/b" + WS, ACCEPT)),
    "accept": Struck(ACCEPT, (PROVISION, "bundle listener -o {}/b" + WS)),
    "accept a change": Struck(
        ACCEPT, (PROVISION, "bundle listener -o {}/b" + WS, ACCEPT, narrower, PROVISION, "bundle listener -o {}/b" + WS)
    ),
    "import": Struck("import {}/sros2.xml -o {}/imported", (of_another_tool,)),
    "learn": Struck("learn --from-keystore {}/ks -o {}/learned.xml", (of_another_tool,)),
    "fmt": Struck("fmt {}/policy.xml", (badly_formatted,)),
}
SHOWN = ("rekey of a revoked enclave", "revoke superseded rights", "adopt", "export", "bundle", "harden names")
"""The commands of which the sample strikes more calls: they once ended in a circle."""


def certified(folder: Path) -> set[int]:
    """Return the serial numbers of the certificates that are installed, staged or in a bundle."""
    found = set()
    for path in folder.rglob("cert.pem"):
        found.add(x509.load_pem_x509_certificate(path.read_bytes()).serial_number)
    for path in folder.rglob("*.bundle"):
        files = bundle.read(path.read_bytes(), Origin("test")).files
        found.add(x509.load_pem_x509_certificate(files["cert.pem"]).serial_number)
    return found


def issued(workspace: Path) -> dict[int, Any]:
    path = workspace / "private/register.sqlite3"
    if not path.exists():
        return {}
    found = loaded_register(path.read_bytes(), Origin("test")).certificates
    serials = {serial: each for (_, serial), each in found.items()}
    assert len(serials) == len(found)
    return serials


def temporary(folder: Path) -> list[str]:
    return [path for path in scenarios.tree(folder) if ".keymint-" in path or path.endswith("/running")]


def sample(points: Sequence[Point], most: int, first: int) -> Sequence[Point]:
    """Return the calls to strike, in rotation: so many that change visible names, and half as many others."""
    if FULL:
        return points
    visible = [point for point in points if point.call in CRITICAL]
    others = [point for point in points if point.call not in CRITICAL]
    parts = ((part, max(1, -(-len(part) // number))) for part, number in ((visible, most), (others, most // 2)))
    return [point for part, step in parts for point in part[first % step :: step]]


def looks(folder: Path, start: Path) -> frozenset[tuple[str, str, bool]]:
    """Return what a run left, temporary files included: each path, its mode, and whether it is as it was."""

    def is_same(path: str) -> bool:
        return (start / path).is_file() and filecmp.cmp(folder / path, start / path, shallow=False)

    return frozenset(
        (re.sub(r"-\d+-", "-", path), mode, mode[0] == "-" and is_same(path))
        for path, mode in scenarios.tree(folder).items()
    )


def finished(
    struck: Struck, code: int, folder: Path, before: Mapping[int, Any], checked: int, keymint: Keymint
) -> None:
    """Check what the same command leaves after a run that did not come to its end; that command ends with ``code``."""
    again = keymint(*struck.line(folder))
    assert again.code == code, again.out + again.err
    assert temporary(folder) == []
    if not (folder / "ws").exists():
        return
    found = keymint("check", "-w", folder / "ws")
    assert found.code == checked, found.out + found.err
    there = certified(folder)
    for serial, each in issued(folder / "ws").items():
        assert serial in before or serial in there or each.reason == "abandoned", (serial, each)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_same_command_finishes_what_was_interrupted(name: str, memory: Path, keymint: Keymint) -> None:
    struck = COMMANDS[name]
    start, undisturbed = memory / "start", memory / "undisturbed"
    start.mkdir()
    (start / "policy.xml").write_text(scenarios.policy("/robot/talker", "/listener"))
    for step in struck.before:
        if callable(step):
            step(start)
        else:
            outcome = keymint(*words(step, start))
            assert outcome.code == 0, outcome.out + outcome.err
    before = issued(start / "ws")
    shutil.copytree(start, undisturbed)
    traced = tracing.trace(struck.line(undisturbed), undisturbed, memory)
    assert traced.ended.code == struck.code, traced.ended.output
    checked = keymint("check", "-w", undisturbed / "ws").code
    repeated = keymint(*struck.line(undisturbed)).code  # what follows a run that can do without a refused call
    assert not (struck.checked and checked and (undisturbed / "ws").exists())
    at, met = [*COMMANDS].index(name), set[frozenset[tuple[str, str, bool]]]()
    for how in (KILLED, *ERRORS) if FULL else (KILLED, ERRORS[at % 3]):
        points = sample(traced.points, (6 if name in SHOWN else 2) if how == KILLED else 2, at)
        copies = [memory / f"copy-{number}" for number in range(len(points))]
        jobs: list[tuple[Point, list[str]]] = []
        for point, copy in zip(points, copies, strict=True):
            shutil.copytree(start, copy)
            jobs.append((point, struck.line(copy)))
        ended: list[Ended] = tracing.strike(how, jobs, traced, memory)
        for (point, _), copy, end in zip(jobs, copies, ended, strict=True):
            try:
                assert "internal error" not in end.output
                look = looks(copy, start)
                if look not in met:
                    met.add(look)
                    code = repeated if end.code == struck.code else struck.code
                    finished(struck, code, copy, before, checked, keymint)
            except Exception as error:
                error.add_note(f"{name}: {how} at {point}\n{end.output}")
                raise
            shutil.rmtree(copy)
