# SPDX-License-Identifier: Apache-2.0
"""What vendors do with revocation lists, several authorities and expiry: the facts that the verbs rely on.

Every fact about the creation of a participant is also compared with the model of the vendor.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.transports.enclave_model import EnclaveModel
from keymint_ros2_dds.vendors.participants import CycloneDDS, ProbeEndpoint, RefusedError, System, Vendor

from keymint.api import Environment, InstalledEnclave

from .conftest import on_each_fastdds, variation_of
from .handmade import Authorities, Authority
from .lifetimes import DAY, Identity, enclave, identity, revocation_list
from .presenters import presenting
from .probe_commands import await_rejection

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

BOTH, NEITHER, CYCLONE, FAST = ("cyclonedds", "fastdds"), (), ("cyclonedds",), ("fastdds",)
WAIT = 10.0


@dataclass(frozen=True)
class Place:
    """The authorities, an identity of the first one, and another authority of the same name."""

    authorities: Authorities
    own: Identity
    peer: Identity
    namesake: Authority

    @property
    def ca(self) -> Authority:
        return self.authorities.identity


@pytest.fixture(scope="module")
def place(authorities: Authorities) -> Place:
    ca = authorities.identity
    namesake = Authority.new("identity authority")
    return Place(authorities, identity(ca, "/own"), identity(ca, "/peer"), namesake)


def model_of(vendor: Vendor, folder: Path, distro: str = "jazzy") -> str:
    """Return why the model of a vendor refuses an enclave, or an empty text."""
    found = EnclaveModel(
        InstalledEnclave("/own", folder, distro, folder.parent), Environment(datetime.now(UTC), folder.parent), 0
    )
    return found.refusal or found.unauthenticated(variation_of(vendor))


def name_of(vendor: Vendor) -> str:
    return "cyclonedds" if isinstance(vendor, CycloneDDS) else "fastdds"


CREATION: dict[str, tuple[tuple[str, ...], Callable[[Place], dict[str, object]]]] = {
    "no list": (BOTH, lambda _: {}),
    "an empty list": (BOTH, lambda at: {"crl": revocation_list(at.ca)}),
    "another serial": (BOTH, lambda at: {"crl": revocation_list(at.ca, [at.peer])}),
    "its own serial": (NEITHER, lambda at: {"crl": revocation_list(at.ca, [at.own])}),
    "an expired list": (NEITHER, lambda at: {"crl": revocation_list(at.ca, begin=-2 * DAY, end=-DAY)}),
    "a list from tomorrow on": (NEITHER, lambda at: {"crl": revocation_list(at.ca, begin=DAY, end=2 * DAY)}),
    "a list of a namesake": (NEITHER, lambda at: {"crl": revocation_list(at.namesake)}),
    "a list of another authority": (NEITHER, lambda at: {"crl": revocation_list(at.authorities.permissions)}),
    "garbage": (NEITHER, lambda _: {"crl": b"garbage\n"}),
    "an empty file": (NEITHER, lambda _: {"crl": b""}),
    "only the first list is read": (
        BOTH,
        lambda at: {"crl": revocation_list(at.ca) + revocation_list(at.ca, [at.own])},
    ),
    "the first list is another's": (
        NEITHER,
        lambda at: {"crl": revocation_list(at.authorities.permissions) + revocation_list(at.ca)},
    ),
    "revoked among the authorities": (
        CYCLONE,
        lambda at: {"trusted": at.ca.pem + revocation_list(at.ca, [at.own])},
    ),
    "an empty list among the authorities": (BOTH, lambda at: {"trusted": at.ca.pem + revocation_list(at.ca)}),
    "its issuer comes second": (FAST, lambda at: {"trusted": at.authorities.permissions.pem + at.ca.pem}),
    "its issuer comes first": (BOTH, lambda at: {"trusted": at.ca.pem + at.authorities.permissions.pem}),
    "its issuer is not trusted": (NEITHER, lambda at: {"trusted": at.authorities.permissions.pem}),
    "an expired certificate": (
        NEITHER,
        lambda at: {"who": identity(at.ca, "/own", begin=-2 * DAY, end=-DAY)},
    ),
    "a certificate from tomorrow on": (NEITHER, lambda at: {"who": identity(at.ca, "/own", begin=DAY, end=2 * DAY)}),
}
"""By what the enclave has: which vendors create the participant, and how the enclave is written."""


@pytest.mark.parametrize("case", CREATION)
def test_whether_a_participant_is_created(
    place: Place, vendor: Vendor, system: System, tmp_path: Path, case: str
) -> None:
    vendors, made = CREATION[case]
    written = {"who": place.own, **made(place)}
    folder = enclave(place.authorities, tmp_path / "own", **written)  # type: ignore[arg-type]
    try:
        system.open(folder)
        created = True
    except RefusedError:
        created = False
    assert created == (name_of(vendor) in vendors)
    refusal = model_of(vendor, folder)
    assert (not refusal) == created, refusal


def test_before_humble_nobody_reads_the_list(place: Place, vendor: Vendor, system: System, tmp_path: Path) -> None:
    folder = enclave(place.authorities, tmp_path / "own", place.own, crl=b"garbage\n")
    assert model_of(vendor, folder, "galactic") == ""
    system.open(folder, revocations=False)


def test_a_revoked_peer_is_refused_by_whoever_has_the_list_and_the_others_go_on(
    place: Place, system: System, tmp_path: Path
) -> None:
    third = identity(place.ca, "/third")
    crl = revocation_list(place.ca, [place.peer])
    informed = system.open(enclave(place.authorities, tmp_path / "own", place.own, crl=crl)).edge("subscribe", "rt/x")
    trusting = system.open(enclave(place.authorities, tmp_path / "third", third)).edge("subscribe", "rt/x")
    revoked = system.open(enclave(place.authorities, tmp_path / "peer", place.peer)).edge("publish", "rt/x")
    revoked.write("from the revoked one")
    assert await_rejection(informed, WAIT)
    assert trusting.read(WAIT) == "from the revoked one"
    good = system.open(enclave(place.authorities, tmp_path / "good", third)).edge("publish", "rt/x")
    good.write("from another")
    assert (informed.read(WAIT), trusting.read(WAIT)) == ("from another", "from another")


def test_a_running_participant_reads_no_new_list_and_a_restarted_one_does(
    place: Place, vendor: Vendor, tmp_path: Path
) -> None:
    listener = enclave(place.authorities, tmp_path / "own", place.own, crl=revocation_list(place.ca))
    talker = enclave(place.authorities, tmp_path / "peer", place.peer)
    with System(vendor) as system:
        reader = system.open(listener).edge("subscribe", "rt/x")
        writer = matched(system, talker, reader)
        (listener / "crl.pem").write_bytes(revocation_list(place.ca, [place.peer]))
        writer.write("still here")
        assert reader.read(WAIT) == "still here"
        again = system.open(talker).edge("publish", "rt/x")
        again.write("and again, after a restart of the revoked one")
        assert str(reader.read(WAIT)).startswith("and again")
    with System(vendor) as system:
        reader = system.open(listener).edge("subscribe", "rt/x")
        system.open(talker).edge("publish", "rt/x").write("too late")
        assert await_rejection(reader, WAIT)


def matched(system: System, folder: Path, reader: ProbeEndpoint) -> ProbeEndpoint:
    """Start a writer, and wait until its first sample has arrived."""
    writer = system.open(folder).edge("publish", "rt/x")
    writer.write("hello")
    assert reader.read(WAIT) == "hello"
    return writer


@dataclass(frozen=True)
class Expiring:
    """Participants whose files end soon, all connected.

    Attributes:
        end: when certificate, grant and list end.
        reader: has a list that ends.
        ending: writers whose certificate and whose grant end.
        lasting: a writer without an end.
        folders: their enclaves: with the certificate and with the grant that end, and the one without an end.
    """

    end: datetime
    reader: ProbeEndpoint
    ending: tuple[ProbeEndpoint, ...]
    lasting: ProbeEndpoint
    folders: tuple[Path, Path, Path]


def connected(place: Place, system: System, folder: Path, seconds: int) -> Expiring | None:
    """Connect them; return None if this took longer than the files last."""
    end = timedelta(seconds=seconds)
    expiring = identity(place.ca, "/expiring", end=end)
    by_certificate = enclave(place.authorities, folder / "certificate", expiring)
    by_grant = enclave(place.authorities, folder / "grant", identity(place.ca, "/granted"), end=end)
    good = enclave(place.authorities, folder / "good", place.peer)
    own = enclave(place.authorities, folder / "own", place.own, crl=revocation_list(place.ca, end=end))
    last = expiring.certificate.not_valid_after_utc
    try:
        reader = system.open(own).edge("subscribe", "rt/x")
        ending = tuple(matched(system, each, reader) for each in (by_certificate, by_grant))
        lasting = matched(system, good, reader)
    except (AssertionError, RefusedError):
        if datetime.now(UTC) < last:
            raise
        return None
    in_time = datetime.now(UTC) < last
    return Expiring(last, reader, ending, lasting, (by_certificate, by_grant, good)) if in_time else None


def test_what_expires_while_it_runs(place: Place, vendor: Vendor, tmp_path: Path) -> None:
    """Cyclone DDS drops the peer in silence: its writes succeed. Fast DDS 2.9 goes on. Neither connects again."""
    for attempt in range(4):
        with System(vendor) as system:
            found = connected(place, system, tmp_path / str(attempt), 4 * 2**attempt)
            if found is None:
                continue  # the machine is busy
            time.sleep(max((found.end - datetime.now(UTC)).total_seconds(), 0) + 2.5)
            for writer in (*found.ending, found.lasting):
                writer.write("after the end")
            reads = 1 if isinstance(vendor, CycloneDDS) else 3
            assert [found.reader.read(WAIT) for _ in range(reads)] == ["after the end"] * reads
            assert found.reader.read(0.5) is None
            by_certificate, by_grant, good = found.folders
            for folder in (by_certificate, by_grant):
                with pytest.raises(RefusedError):
                    system.open(folder)
            newcomer = system.open(good).edge("publish", "rt/x")
            newcomer.write("the list of the reader has expired")
            assert found.reader.read(1.0) is None
            return
    pytest.fail("the machine is too busy to connect four participants in half a minute")


def test_two_identity_authorities_side_by_side(place: Place, vendor: Vendor, system: System, tmp_path: Path) -> None:
    """A rollover of the key: on Fast DDS enclaves of both authorities meet; Cyclone DDS trusts the first alone."""
    bundle = place.namesake.pem + place.ca.pem
    old = enclave(place.authorities, tmp_path / "old", place.own, trusted=bundle)
    new = enclave(place.authorities, tmp_path / "new", identity(place.namesake, "/new"), trusted=bundle)
    reader = system.open(new).edge("subscribe", "rt/x")
    if isinstance(vendor, CycloneDDS):
        with pytest.raises(RefusedError):
            system.open(old)
    else:
        matched(system, old, reader)


@on_each_fastdds
def test_two_authorities_need_a_list_each_and_inside_the_file_of_authorities(
    place: Place, vendor: Vendor, tmp_path: Path
) -> None:
    """Fast DDS reads one list of ``crl.pem``, and any number beside the authorities."""
    newcomer = identity(place.namesake, "/new")
    bundle, lists = place.ca.pem + place.namesake.pem, (revocation_list(place.ca), revocation_list(place.namesake))
    for together in (lists[0] + lists[1], b""):
        with System(vendor) as system:
            written = {"trusted": bundle, "crl": together} if together else {"trusted": bundle + b"".join(lists)}
            reader = system.open(enclave(place.authorities, tmp_path / "own", place.own, **written)).edge(
                "subscribe", "rt/x"
            )
            writer = system.open(enclave(place.authorities, tmp_path / "new", newcomer, trusted=bundle)).edge(
                "publish", "rt/x"
            )
            writer.write("hello")
            if together:
                assert await_rejection(reader, WAIT)
            else:
                assert reader.read(WAIT) == "hello"


def test_an_identity_authority_that_is_reissued_for_its_key_needs_no_coordination(
    place: Place, system: System, tmp_path: Path
) -> None:
    reissued = Authority.new("identity authority", key=place.ca.key)
    old = enclave(place.authorities, tmp_path / "old", place.own)
    new = enclave(place.authorities, tmp_path / "new", identity(reissued, "/new"), trusted=reissued.pem)
    reader = system.open(old).edge("subscribe", "rt/x")
    matched(system, new, reader)


def test_old_permissions_do_not_fit_a_certificate_of_another_generation(
    place: Place, vendor: Vendor, probe_cache: Path, tmp_path: Path
) -> None:
    """Whoever has a new certificate cannot present an old document: each peer refuses it, without any list."""
    ca, key = place.ca, place.own.key
    first, second = identity(ca, "/talker", "1", key=key), identity(ca, "/talker", "2", key=key)
    listener = enclave(place.authorities, tmp_path / "listener", place.peer)
    old = enclave(place.authorities, tmp_path / "old", first) / "permissions.p7s"
    new = enclave(place.authorities, tmp_path / "new", second)
    for document, refused in ((old, True), (new / "permissions.p7s", False)):
        with System(presenting(vendor, probe_cache, document)) as system:
            reader = system.open(listener).edge("subscribe", "rt/x")
            writer = system.open(new, conforming=False).edge("publish", "rt/x")
            writer.write("hello")
            if refused:
                assert await_rejection(reader, WAIT)
            else:
                assert reader.read(WAIT) == "hello"
    (new / "permissions.p7s").write_bytes(old.read_bytes())
    with System(vendor) as system, pytest.raises(RefusedError):
        system.open(new)
