# SPDX-License-Identifier: Apache-2.0
"""Signed files as OpenSSL, Cyclone DDS and Fast DDS read them: a file that we accept has the same content for all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.participants import RefusedError, System

from keymint.errors import KeymintError
from keymint.pki import smime
from tests.effort import tries
from tests.keymint.pki.test_signed_forms import spliced
from tests.signers import HAVE_OPENSSL, SIGNERS

from .handmade import criteria, permissions_document, rule
from .signed_readers import Bench

if TYPE_CHECKING:
    from pathlib import Path

    from keymint_ros2_dds.vendors.participants import Vendor

    from .handmade import Authorities

pytestmark = pytest.mark.skipif(not HAVE_OPENSSL, reason="openssl is not installed: apt-get install openssl")
FILES = tries(400, 1_000)
"""Mutated files of a seed; the documents are signed again for each."""


@pytest.fixture(scope="module", params=range(1_000_000, 1_000_000 + 1_000 * tries(1, 20), 1_000))
def seed(request: pytest.FixtureRequest) -> int:
    return request.param


@pytest.fixture(scope="module")
def bench(seed: int, tmp_path_factory: pytest.TempPathFactory, cyclone_plugins: None) -> Bench:
    return Bench(tmp_path_factory.mktemp("signed"), cyclone=True)


@pytest.mark.cyclonedds
def test_all_readers_see_the_same_content_in_files_of_common_tools(bench: Bench) -> None:
    for name, signed, text in bench.genuine:
        assert bench.by_keymint(signed) == text, name
        for reader, read in bench.readers.items():
            content = read(signed)
            assert content is not None, (name, reader)
            assert content.replace(b"\r\n", b"\n") == text, (name, reader)


@pytest.mark.cyclonedds
def test_mutated_files_that_we_accept_have_the_same_content_for_all(bench: Bench, seed: int) -> None:
    comparison = bench.compare(FILES, seed, every=tries(10, 1))
    assert comparison.wrong == []
    assert comparison.counts["files"] == FILES
    assert comparison.counts["accepted by Keymint"] > FILES // 20
    assert comparison.counts["refused by Keymint, accepted by a vendor or openssl"] > FILES // 20
    assert comparison.counts["openssl and Python's email read different contents"] > 0


def permissions(topic: str) -> bytes:
    return permissions_document("CN=/talker", rule("allow", criteria("publish", [topic]))).encode()


def permitted(vendor: Vendor, folder: Path, *topics: str) -> list[bool]:
    """Return for each topic whether a real participant may publish it; False if the participant is refused."""
    with System(vendor) as system:
        try:
            participant = system.open(folder)
        except RefusedError:
            return [False] * len(topics)
        return [participant.allows("publish", topic, ()) for topic in topics]


@pytest.mark.parametrize(
    "signer", ["openssl-smime", "openssl-smime-crlf", "openssl-smime-sha512", "openssl-cms", "sros2"]
)
def test_vendors_accept_files_signed_by_other_tools(
    authorities: Authorities, vendor: Vendor, tmp_path: Path, signer: str
) -> None:
    folder, own = authorities.enclave(tmp_path), authorities.permissions
    content = permissions("rt/x")
    signed = SIGNERS[signer](content, own.certificate, own.key)
    (folder / "permissions.p7s").write_bytes(signed)
    assert permitted(vendor, folder, "rt/x", "rt/y") == [True, False]
    assert smime.verify(signed, own.pem) == content


@pytest.mark.parametrize("signer", ["keymint", "openssl-smime", "sros2"])
def test_vendors_read_the_old_document_of_a_spliced_file(
    authorities: Authorities, vendor: Vendor, tmp_path: Path, signer: str
) -> None:
    folder, own = authorities.enclave(tmp_path), authorities.permissions
    old, current = (SIGNERS[signer](permissions(topic), own.certificate, own.key) for topic in ("rt/old", "rt/now"))
    forged = spliced(old, current)
    (folder / "permissions.p7s").write_bytes(forged)
    assert permitted(vendor, folder, "rt/old", "rt/now") == [True, False]
    with pytest.raises(KeymintError, match="malformed or ambiguous"):
        smime.verify(forged, own.pem)
