# SPDX-License-Identifier: Apache-2.0
"""Which name of a grant fits a certificate on each version of Fast DDS: for the participant itself, and for its peers.

A peer is shown the document by a holder who checks another one: what it refuses, no holder of the certificate can use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from cryptography.x509.oid import NameOID
from keymint_ros2_dds.decision.semantics import FASTDDS_2_9, VARIATIONS
from keymint_ros2_dds.vendors.participants import RefusedError, System, Vendor

from tests.effort import tries

from .conftest import on_each_fastdds
from .handmade import Authorities
from .lifetimes import EVERYTHING
from .presenters import presenting
from .probe_commands import MatchedError, await_rejection

if TYPE_CHECKING:
    from pathlib import Path

TALKER = ((NameOID.ORGANIZATIONAL_UNIT_NAME, "1"), (NameOID.COMMON_NAME, "/talker"))
"""In RFC 4514: ``CN=/talker,OU=1``, the enclave /talker in its first generation."""
TWICE = ((NameOID.COMMON_NAME, "/other"), (NameOID.COMMON_NAME, "/talker"))
OLD, NEW = "2.9", "3"
NAMES = {
    "CN=/talker,OU=2": (),
    "OU=1,CN=/talker": (NEW,),
    'CN="/talker",OU=1': (NEW,),
    "CN=/talker,OU=1": (OLD, NEW),
    " CN=/talker,OU=1": (OLD, NEW),
    "CN=/talker, OU=1": (OLD, NEW),
    "CN = /talker, OU = 1": (NEW,),
    r"CN=\/talker,OU=1": (NEW,),
    "CN=/talker+OU=1": (),
    "CN=/other,OU=1": (),
    "CN=/talker": (),
    "CN=/talker,OU=1,O=x": (),
    "CN=/talke,OU=1": (),
    "cn=/talker,OU=1": (),
    "2.5.4.3=/talker,OU=1": (),
    "CN=/talker;OU=1": (),
    r"CN=\2Ftalker,OU=1": (),
    "/OU=1/CN=/talker": (),
    "CN=/talker,OU=1,": (OLD, NEW),
    "CN=/talker,OU=1,,x": (OLD, NEW),
    "CN=/talker,OU=1,,CN=/other": (OLD,),
    "CN=/talker,,OU=1": (),
    ",CN=/talker,OU=1": (),
}
"""Names of grants for the certificate of /talker, and the versions that take them."""
NAMES_OF_TWICE = {
    "CN=/talker,CN=/other": (OLD,),
    "CN=/talker,CN=/talker": (NEW,),
    "CN=/other,CN=/other": (),
}
"""The same for a certificate with two common names."""
PLUS = ((NameOID.COMMON_NAME, "/a+OU=x"),)
NAMES_OF_PLUS = {"CN=/a+OU=x": (NEW,), r"CN=/a\+OU=x": (OLD, NEW), "CN=/a,OU=x": ()}
COMMA = ((NameOID.ORGANIZATIONAL_UNIT_NAME, "x"), (NameOID.COMMON_NAME, ",OU=x"))
NAMES_OF_COMMA = {"CN=,OU=x": (NEW,), r"CN=\,OU=x,OU=x": (OLD, NEW)}
OTHER = ((NameOID.ORGANIZATION_NAME, "b"), (NameOID.COMMON_NAME, "/a"))
NAMES_OF_OTHER = {"OU=,CN=/a": (), "CN=/a,OU=": (NEW,), "=,CN=/a": (), "CN=/a,=": (NEW,), "CN=/a,O=b": (OLD, NEW)}
"""The same for names with separators in a value, and for empty values and types in the grant's."""
CERTIFICATES = {
    "CN=/talker,OU=1": (TALKER, NAMES),
    "CN=/talker,CN=/other": (TWICE, NAMES_OF_TWICE),
    r"CN=/a\+OU=x": (PLUS, NAMES_OF_PLUS),
    r"CN=\,OU=x,OU=x": (COMMA, NAMES_OF_COMMA),
    "CN=/a,O=b": (OTHER, NAMES_OF_OTHER),
}
"""The subject of a certificate, in RFC 4514: its RDNs, and the names of grants."""
ODD = "DistinguishedName "
"""How Fast DDS begins to complain of the form of a name, which decides nothing yet."""


def created(vendor: Vendor, folder: Path) -> bool:
    with System(vendor) as system:
        try:
            system.open(folder)
        except RefusedError:
            return False
        return True


def accepted(vendor: Vendor, cache: Path, listener: Path, holder: Path, document: Path) -> bool:
    """Tell whether a peer talks to a holder who shows it a document."""
    with System(presenting(vendor, cache, document)) as system:
        reader = system.open(listener).edge("subscribe", "rt/x")
        system.open(holder, conforming=False).edge("publish", "rt/x").write("hello")
        try:
            while (refused := await_rejection(reader, 10.0)) and refused.startswith(ODD) and "; " not in refused:
                pass
        except MatchedError:
            return reader.read() == "hello"
    assert refused, "neither matched nor refused in time"
    return False


@on_each_fastdds
@pytest.mark.parametrize(("rdns", "names"), CERTIFICATES.values(), ids=CERTIFICATES)
def test_names_of_grants(
    authorities: Authorities, vendor: Vendor, probe_cache: Path, tmp_path: Path, rdns: tuple, names: dict
) -> None:
    version = OLD if vendor.version is None else NEW
    own = next(name for name, takers in names.items() if version in takers)
    listener = authorities.enclave(tmp_path / "listener", EVERYTHING, name="/listener")
    holder = authorities.enclave(tmp_path / "holder", EVERYTHING, rdns=rdns, subject=own)
    for number, (name, takers) in enumerate(list(names.items())[: tries(4, 100)]):
        folder = authorities.enclave(tmp_path / str(number), EVERYTHING, rdns=rdns, subject=name)
        found = created(vendor, folder), accepted(vendor, probe_cache, listener, holder, folder / "permissions.p7s")
        assert found == ((version in takers,) * 2), name


@pytest.mark.parametrize(("version", "model"), [(OLD, FASTDDS_2_9.name), (NEW, "fastdds-3.3")])
def test_the_models_take_the_same_names(version: str, model: str) -> None:
    if model not in VARIATIONS:
        pytest.skip(f"there is no model {model}")
    selects = VARIATIONS[model].semantics.selects
    for identity, (_, names) in CERTIFICATES.items():
        for name, takers in names.items():
            assert selects(name, identity) == (version in takers), name
