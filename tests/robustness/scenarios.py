# SPDX-License-Identifier: Apache-2.0
"""Runs to disturb, and checks of the workspace after a disturbance."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from lxml import etree

from comarmor.errors import Origin
from keymint import cli
from keymint.life.register import Register, loaded_register
from keymint.pki import smime

_RULES = """<ros_topic qualifier="ALLOW">
  <attachment>/chatter{}</attachment><permissions><ros_publish/></permissions>
</ros_topic>"""


def policy(*subjects: str, version: str = "") -> str:
    """Return a policy of these subjects; the version changes a rule of ``/robot/talker``."""
    profiles = (
        f'<profile name="{subject}"><attachment>{subject}</attachment>'
        f"{_RULES.format(version if subject == '/robot/talker' else '')}</profile>"
        for subject in subjects
    )
    return f"<profiles>{''.join(profiles)}</profiles>"


def _nothing(_folder: Path) -> None:
    """Start without a workspace."""


def _change_policy(folder: Path) -> None:
    # /robot becomes an enclave around one that is there; /new/deep/one comes with folders of its own.
    subjects = ("/robot", "/robot/talker", "/listener", "/new/deep/one")
    (folder / "policy.xml").write_text(policy(*subjects, version="_changed"))


def _change_everything(folder: Path) -> None:
    # Of every enclave, the nested ones included, the rules and the governance change.
    subjects = ("/robot", "/robot/talker", "/listener", "/new/deep/one")
    (folder / "policy.xml").write_text(policy(*subjects, version="_again").replace("/chatter", "/chat"))
    for governance in folder.glob("ws/profile/package.defaults/governance.xml"):
        text = governance.read_text()
        assert "<rtps_protection_kind>SIGN" in text
        governance.write_text(text.replace("<rtps_protection_kind>SIGN", "<rtps_protection_kind>ENCRYPT"))


def _rename_listener(folder: Path) -> None:
    (folder / "policy.xml").write_text(policy("/robot/talker", "/hearer"))


def _remove_packages(folder: Path) -> None:
    (folder / "policy.xml").write_text(policy("/robot/talker"))
    for file in (folder / "ws" / "src" / "robot").glob("*.xml"):
        file.unlink()
    shutil.rmtree(folder / "ws" / "src" / "new")
    shutil.rmtree(folder / "ws" / "src" / "listener")


def _make_older(folder: Path) -> None:
    # What begins today is not renewed today.
    for name in ("identities", "permissions"):
        defaults = folder / f"ws/profile/package.defaults/{name}.xml"
        text = defaults.read_text()
        assert "<not_before>2027-01-14T" in text
        defaults.write_text(text.replace("<not_before>2027-01-14T", "<not_before>2026-10-14T"))


@dataclass(frozen=True)
class Scenario:
    """A run to disturb.

    Attributes:
        before: runs that prepare it.
        change: applies a user's change to the folder of the workspace and the policy.
        verb: the arguments of the run; ``{}`` is replaced by the folder.
    """

    before: tuple[Callable[[Path], None], ...]
    change: Callable[[Path], None]
    verb: tuple[str, ...]

    def arguments(self, folder: Path) -> list[str]:
        """Return the run's command line in a folder."""
        return [argument.format(folder) for argument in self.verb]


PROVISION = ("provision", "{}/policy.xml", "-w", "{}/ws", "-j", "1")
PRUNE = ("install", "--prune", "--no-prove", "-w", "{}/ws", "-j", "1")
"""The packages were created from another policy."""


def _replace(*phase: str) -> tuple[str, ...]:
    return ("authority", "replace", "identity_ca", *phase, "-w", "{}/ws")


BUNDLE, REISSUE, END = ("--vendor", "fastdds"), ("--phase", "reissue"), ("--phase", "end")


def _reached(*phases: tuple[str, ...]) -> Callable[[Path], None]:
    """Return what carries out phases in which the key of an authority is replaced."""

    def reach(folder: Path) -> None:
        for phase in phases:
            words = [each.format(folder) for each in _replace(*phase)]
            assert cli.main([*words, "-q"]) == 0, words

    return reach


SCENARIOS: Mapping[str, Scenario] = {
    "fresh": Scenario((), _nothing, PROVISION),
    "update": Scenario((_nothing,), _change_policy, PROVISION),
    "renew": Scenario((_nothing,), _nothing, (*PROVISION, "--rekey=*", "--yes")),
    "everything": Scenario((_nothing, _change_policy), _change_everything, (*PROVISION, "--rekey=*", "--yes")),
    "revoke": Scenario((_nothing,), _nothing, ("revoke", "listener", "--reason", "superseded", "-w", "{}/ws")),
    "retire": Scenario((_nothing,), _nothing, ("revoke", "listener", "--reason", "retired", "-w", "{}/ws")),
    "remove": Scenario((_nothing,), _rename_listener, ("remove", "listener", "-w", "{}/ws")),
    "renewal": Scenario((_nothing, _make_older), _nothing, ("renew", "listener", "-w", "{}/ws")),
    "rekey": Scenario((_nothing, _make_older), _nothing, ("renew", "--rekey", "listener", "-w", "{}/ws")),
    "distribute": Scenario((_nothing,), _nothing, _replace(*BUNDLE)),
    "reissue": Scenario((_nothing,), _reached(BUNDLE), _replace(*REISSUE)),
    "end": Scenario((_nothing,), _reached(BUNDLE, REISSUE), _replace(*END)),
    "stage": Scenario((_nothing,), _nothing, _replace()),
    "exchange": Scenario((_nothing,), _reached(()), _replace(*END)),
    "prune": Scenario((_nothing, _change_policy), _remove_packages, PRUNE),
}
RARE = frozenset({"renew", "rekey", "distribute", "end", "stage"})
"""Scenarios that only the tests of all calls have: they write what others write, too."""
KEYS_MOVE = frozenset({REISSUE[-1], END[-1]})
"""Words of runs in which a private key takes the place of another one."""


def unproven(scenario: Scenario) -> tuple[str, ...]:
    """Return the option of ``check`` for enclaves that were installed without a proof, and differ from the policy."""
    return ("--no-prove",) if "--no-prove" in scenario.verb else ()


def tree(workspace: Path, *, answers: bool = False) -> dict[str, str]:
    """Return every path of a workspace with its type and mode.

    Args:
        workspace: the workspace.
        answers: also recorded answers; whether a run may record its own depends on how old the policy is.
    """
    found = {}
    for folder, folders, files in os.walk(workspace):
        for name in (*folders, *files):
            path = os.path.join(folder, name)  # noqa: PTH118 - called hundreds of times
            mode = os.lstat(path).st_mode
            relative = path[len(str(workspace)) + 1 :]
            if answers or not relative.startswith(".keymint/last-"):
                found[relative] = f"{'d' if stat.S_ISDIR(mode) else '-'}{stat.S_IMODE(mode):04o}"
    return found


def keys(workspace: Path) -> dict[str, bytes]:
    """Return the private keys at their final paths."""
    found = {}
    for path in (workspace / "private").rglob("*.pem"):
        if not _hidden(path.relative_to(workspace)):
            found[str(path.relative_to(workspace))] = path.read_bytes()
    return found


def _hidden(path: Path) -> bool:
    return any(part.startswith(".keymint-") for part in path.parts)


def enclaves(workspace: Path) -> dict[str, dict[str, bytes]]:
    """Return the files of every visible folder of enclaves, including the folder of all (``.``)."""
    found: dict[str, dict[str, bytes]] = {}
    root = workspace / "install" / "enclaves"
    for folder, _, files in os.walk(root):
        relative = Path(folder).relative_to(root)
        if not _hidden(relative):
            visible = [file for file in files if not _hidden(Path(file))]
            found[str(relative)] = {file: (Path(folder) / file).read_bytes() for file in visible}
    return found


def require_whole_files(workspace: Path) -> int:
    """Check that every visible file of the install space is complete; return their number."""
    count = 0
    for path in sorted((workspace / "install").rglob("*")):
        if _hidden(path.relative_to(workspace)) or path.is_dir():
            continue
        count += 1
        content = path.read_bytes()
        if path.name == "key.pem":
            load_pem_private_key(content, None)
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
            assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
            continue
        assert stat.S_IMODE(path.stat().st_mode) == 0o644, path
        if path.name == "crl.pem":
            require_revocation_list(workspace, content)
        elif path.suffix == ".pem":
            x509.load_pem_x509_certificates(content)
        elif path.suffix == ".p7s":
            authority = workspace / "public" / "permissions_ca.cert.pem"
            etree.fromstring(smime.verify(content, authority.read_bytes()))
        elif path.suffix == ".xml":
            etree.fromstring(content)
        elif path.parent == workspace / "install" and path.stem == "keystore":
            assert b"ROS_SECURITY_STRATEGY" in content, path  # of its last variable
            assert content.endswith(b"\n"), path
        elif path == workspace / "install" / ".gitignore":
            assert content.endswith(b"\n*\n")
        else:
            raise AssertionError(f"unknown file {path}")
    return count


def require_revocation_list(workspace: Path, content: bytes) -> None:
    """Check that a revocation list verifies, and that the register knows it and all its revocations."""
    crl = x509.load_pem_x509_crl(content)
    authority = x509.load_pem_x509_certificate((workspace / "public/identity_ca.cert.pem").read_bytes())
    assert crl.is_signature_valid(authority.public_key())
    register = registered(workspace)
    assert {each.serial_number for each in crl} <= {
        each.serial for each in register.certificates.values() if each.revoked
    }
    assert crl.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number <= max(register.numbers.values())


def registered(workspace: Path) -> Register:
    """Return the register of issued certificates."""
    path = workspace / "private/register.sqlite3"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    return loaded_register(path.read_bytes(), Origin(str(path)))


def require_registered(workspace: Path) -> None:
    """Check that the register has every certificate that is visible: a kill loses no serial number."""
    found = [files["cert.pem"] for files in enclaves(workspace).values() if "cert.pem" in files]
    serials = {x509.load_pem_x509_certificate(pem).serial_number for pem in found}
    assert not serials or serials <= {each.serial for each in registered(workspace).certificates.values()}


def require_whole_enclaves(
    workspace: Path, before: Mapping[str, Mapping[str, bytes]], after: Mapping[str, Mapping[str, bytes]]
) -> None:
    """Check that every enclave is completely old or completely new, even if it contains others.

    Args:
        workspace: after the run was disturbed.
        before: the folders among the enclaves before the run, with their files.
        after: those after an undisturbed run. Signatures and keys differ from run to run.
    """
    for name, files in enclaves(workspace).items():
        old, new = before.get(name, {}), after.get(name, {})
        if files == old:
            continue
        assert set(files) == set(new), (name, set(files), set(old), set(new))
        same = {file for file in files if files[file] == old.get(file)}
        assert same == {file for file in new if new[file] == old.get(file)}, (name, same)
    for files in enclaves(workspace).values():
        require_fitting(files)
    require_registered(workspace)


def require_fitting(files: Mapping[str, bytes]) -> None:
    """Check that the files of an enclave belong together."""
    if "key.pem" in files:
        key = load_pem_private_key(files["key.pem"], None).public_key()
        assert key == x509.load_pem_x509_certificate(files["cert.pem"]).public_key()
    for kind in ("permissions", "governance"):
        if {f"{kind}.xml", f"{kind}.p7s"} <= set(files):
            assert smime.signed_content(files[f"{kind}.p7s"]).split() == files[f"{kind}.xml"].split(), kind
