# SPDX-License-Identifier: Apache-2.0
"""The layouts of a keystore, and the files of an enclave in each."""

from __future__ import annotations

from collections.abc import Mapping

from keymint.api import Layout

LAYOUTS: Mapping[str, Layout] = {
    "sros2": Layout("enclaves"),
    "flat": Layout("", reserved=("enclaves", "private", "public")),
}
"""The layouts; in ``flat``, subjects must not have the names of the folders at the top of ``sros2``."""
READS = (".pem", ".p7s", ".p11")
"""Suffixes of the files that ROS 2 reads from an enclave, also through links (rmw_dds_common, security.cpp)."""
PERMISSIONS = "permissions"
GOVERNANCE = "governance"
PERMISSIONS_XML = f"{PERMISSIONS}.xml"
GOVERNANCE_XML = f"{GOVERNANCE}.xml"
PERMISSIONS_P7S = f"{PERMISSIONS}.p7s"
GOVERNANCE_P7S = f"{GOVERNANCE}.p7s"
CERTIFICATE, KEY = "cert.pem", "key.pem"
KEY_URI = "key.p11"
"""In place of the key: a text file with the URI of a key in a token, which rmw_fastrtps reads from Jazzy on."""
READS_KEY_URI = ("jazzy", "kilted", "lyrical", "rolling")
"""The distributions that read it (rmw_dds_common, ``security.cpp``)."""
CA, IDENTITY_CA, PERMISSIONS_CA = "ca.cert.pem", "identity_ca.cert.pem", "permissions_ca.cert.pem"
CRL = "crl.pem"
"""The revocation list of an enclave; see :func:`reads_revocations`."""
_WITHOUT_REVOCATIONS = frozenset(("ardent", "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic"))

_READ = (CERTIFICATE, KEY, GOVERNANCE_P7S, PERMISSIONS_P7S)
_FILES: Mapping[str, tuple[str, ...]] = {
    "sros2": (IDENTITY_CA, PERMISSIONS_CA, *_READ, PERMISSIONS_XML),
    "flat": (CA, *_READ),
}
_FLAT_WITH_TWO = frozenset(("crystal", "dashing", "eloquent"))
"""The distributions that read the flat layout with a file for each authority (rmw_fastrtps#227, rmw_connext#301).

Ardent and Bouncy read one ``ca.cert.pem``. Nothing from Foxy on reads the flat layout, so there it stays what it was.
"""
COPIED = (IDENTITY_CA, PERMISSIONS_CA, GOVERNANCE_P7S)
"""The files that ``sros2`` has once more outside of the enclaves, for people and for sros2's tools."""


def has_one_authority(layout: str, distro: str) -> bool:
    """Tell whether an enclave has one file for both authorities, as the nodes of a distribution look for it."""
    return layout == "flat" and distro not in _FLAT_WITH_TWO


def enclave_files(layout: str, distro: str) -> tuple[str, ...]:
    """Return the names of the files that an enclave always has; none if the layout is not known."""
    if layout == "flat" and not has_one_authority(layout, distro):
        return (IDENTITY_CA, PERMISSIONS_CA, *_READ)
    return _FILES.get(layout, ())


def files(layout: str) -> frozenset[str]:
    """Return the names of all files that may lie in an enclave; see :meth:`keymint.api.BuildType.files`."""
    of_authorities = (IDENTITY_CA, PERMISSIONS_CA) if layout == "flat" else ()
    return frozenset((*_FILES.get(layout, ()), *of_authorities, CRL, *((KEY_URI,) if layout == "sros2" else ())))


def reads_revocations(distro: str, layout: str = "sros2") -> bool:
    """Return whether the nodes of a ROS 2 distribution read the revocation list of their enclave.

    Humble and later give it to the vendor if it exists (rmw_dds_common#52, rmw_cyclonedds#325, rmw_fastrtps#546).

    Args:
        distro: name of the distribution; an unknown one counts as later.
        layout: name of the layout; ``flat`` is that of distributions before Foxy.
    """
    return layout == "sros2" and distro not in _WITHOUT_REVOCATIONS
