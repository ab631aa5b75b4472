# SPDX-License-Identifier: Apache-2.0
"""Transports read copies of enclaves, with keys only if they need them; messages name the originals."""

from __future__ import annotations

import stat
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from comarmor.errors import Origin
from keymint import api
from keymint.api import Availability, InstalledEnclave, Tier, Verdict
from keymint.api.graph import Edge, Object
from keymint.errors import ExitCode, KeymintError
from keymint.verify.copies import enclave_copies
from keymint.view.tree import Tree

EDGE = Edge("/a/b", "ros_publish", Object("ros_topic", "/x"))


@dataclass(frozen=True)
class Transport(api.Transport):
    """Names the folder of its enclave as the reason, or in an error."""

    tiers: tuple[Tier, ...] = (Tier.DECISION,)
    fails: bool = False

    def usable(self) -> Availability:
        return Availability(True, tiers=self.tiers)

    def label(
        self,
        enclaves: Sequence[InstalledEnclave],
        edges: Iterable[Edge],
        tier: Tier,  # noqa: ARG002
    ) -> Iterator[tuple[Edge, Verdict]]:
        (enclave,) = enclaves
        if self.fails:
            where = Origin(str(enclave.folder / "cert.pem"), 3)
            raise KeymintError(
                f"no {enclave.folder}", where=where, help=str(enclave.folder), code="x", exit_code=ExitCode.FINDINGS
            )
        for edge in edges:
            reason = f"{enclave.folder}/permissions.p7s: {(enclave.folder / 'key.pem').exists()}"
            yield edge, Verdict(True, reason, Origin(str(enclave.install / "shared.xml"), 2))


@pytest.fixture
def enclaves(tmp_path: Path) -> dict[str, InstalledEnclave]:
    """Return an enclave with documents, a key, an inner folder, a link and a broken link."""
    folder = tmp_path / "install" / "enclaves" / "a" / "b"
    (folder / "inner").mkdir(parents=True)
    for name in ("permissions.p7s", "key.pem", "authority_key.pem"):
        (folder / name).write_bytes(name.encode())
    (tmp_path / "ca.pem").write_bytes(b"linked")
    (folder / "ca.pem").symlink_to(tmp_path / "ca.pem")
    (folder / "gone.pem").symlink_to("nowhere")
    return {"/a/b": InstalledEnclave("/a/b", folder, "humble", tmp_path / "install")}


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_documents_are_copied_and_removed_at_the_end(tmp_path: Path, enclaves: dict[str, InstalledEnclave]) -> None:
    with enclave_copies(Tree(), tmp_path / "install", enclaves, [Transport()]) as copies:
        folder = copies.enclaves["/a/b"].folder
        assert folder == copies.root / "enclaves" / "a" / "b"
        assert files(folder) == {"permissions.p7s": b"permissions.p7s", "ca.pem": b"linked"}
        assert {stat.S_IMODE(path.lstat().st_mode) for path in folder.iterdir()} == {0o600}
        assert stat.S_IMODE(copies.root.stat().st_mode) == 0o700
    assert not copies.root.exists()


def test_keys_are_copied_if_one_transport_needs_more_than_documents(
    tmp_path: Path, enclaves: dict[str, InstalledEnclave]
) -> None:
    transports = {"model": Transport(), "real": Transport((Tier.DECISION, Tier.EXCHANGE))}
    with enclave_copies(Tree(), tmp_path / "install", enclaves, transports.values()) as copies:
        assert {"key.pem", "authority_key.pem"} <= set(files(copies.enclaves["/a/b"].folder))


def test_a_reason_names_the_original(tmp_path: Path, enclaves: dict[str, InstalledEnclave]) -> None:
    with enclave_copies(Tree(), tmp_path / "install", enclaves, [Transport()]) as copies:
        ((_, verdict),) = Transport().label(list(copies.enclaves.values()), [EDGE], Tier.DECISION)
    reason = f"{enclaves['/a/b'].folder}/permissions.p7s: False"
    assert copies.original(verdict) == Verdict(True, reason, Origin(str(tmp_path / "install/shared.xml"), 2))


def test_shared_files_and_the_infrastructure_are_copied_and_other_enclaves_are_not(
    tmp_path: Path, enclaves: dict[str, InstalledEnclave]
) -> None:
    install = tmp_path / "install"
    for name in ("shared/deep/rights.xml", "enclaves/key.pem", ".hidden/x", "enclaves/server/key.pem", "enclaves/c/x"):
        (install / name).parent.mkdir(parents=True, exist_ok=True)
        (install / name).write_bytes(name.encode())
    others = [install / "enclaves/server", install / "enclaves/c"]
    real = Transport((Tier.DECISION, Tier.EXCHANGE))
    with enclave_copies(Tree(), install, enclaves, [real], others, others[:1]) as copies:
        (enclave,) = copies.enclaves.values()
        assert enclave.install == copies.root
        found = {str(path.relative_to(copies.root)) for path in copies.root.rglob("*") if path.is_file()}
        assert found - {f"enclaves/a/b/{name}" for name in files(enclave.folder)} == {
            "shared/deep/rights.xml",
            "enclaves/key.pem",
            "enclaves/server/key.pem",
        }
    with enclave_copies(Tree(), install, enclaves, [Transport()], others, others[:1]) as copies:
        assert not list(copies.root.rglob("key.pem"))


def test_an_error_names_the_originals(tmp_path: Path, enclaves: dict[str, InstalledEnclave]) -> None:
    transport = Transport(fails=True)
    folder = enclaves["/a/b"].folder
    with pytest.raises(KeymintError) as caught:  # noqa: SIM117 - the error leaves the copies
        with enclave_copies(Tree(), tmp_path / "install", enclaves, [transport]) as copies:
            list(transport.label(list(copies.enclaves.values()), [EDGE], Tier.DECISION))
    (diagnostic,) = caught.value.diagnostics
    assert str(diagnostic) == f"{folder}/cert.pem:3: no {folder} ({folder})"
    assert (diagnostic.code, caught.value.exit_code) == ("x", ExitCode.FINDINGS)
    assert not copies.root.exists()
