# SPDX-License-Identifier: Apache-2.0
"""The layouts of a keystore, the files of an enclave in each, the authorities it rests on, and how ROS 2 finds it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from keymint.api import AuthorityRole, EnvironmentVariable, Implementation, Layout, Package

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


def authority_file(folder: Path, name: str) -> str:
    """Return the file with an authority in an enclave; the layout of Ardent has one file for both."""
    return name if (folder / name).exists() else CA


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


IDENTITY_ROLE, PERMISSIONS_ROLE = "identity", "permissions"
IMPLEMENTATIONS = (
    Implementation("cyclonedds", "Cyclone DDS 0.10", reissues=frozenset({IDENTITY_ROLE})),
    Implementation("fastdds", "Fast DDS 2.9", bundles=frozenset({IDENTITY_ROLE}), reissues=frozenset({IDENTITY_ROLE})),
)
"""What vendors accept while an authority changes, measured. Cyclone DDS reads the first authority of a file only. Fast
DDS tells two authorities of one name that issued identities apart by their key identifiers, but verifies a document
with the first permissions authority of its name. A document is verified with exactly the certificate that signed it."""


def implementations() -> Sequence[Implementation]:
    """Return what was measured: see :meth:`keymint.api.BuildType.implementations`."""
    return IMPLEMENTATIONS


def authorities(package: Package) -> tuple[AuthorityRole, ...]:
    """Return the authorities of a package; see :meth:`keymint.api.BuildType.authorities`.

    Its permissions authority signs the governance as well (DDS Security 1.1, 9.4.1): no other sources are loaded, see
    :func:`keymint_ros2_dds.settings.settings`.
    """
    identity, grant = package.identity, package.grant
    return (
        AuthorityRole(IDENTITY_ROLE, identity.issuer, identity.origin),
        AuthorityRole(PERMISSIONS_ROLE, grant.issuer, grant.origin, signs=True),
    )


_WITH_NODE_DIRECTORY = frozenset(("crystal", "dashing", "eloquent"))
"""The distributions before Foxy in which a variable names the folder of a node itself."""
_BEFORE_FOXY = frozenset(("ardent", "bouncy")) | _WITH_NODE_DIRECTORY
_SWITCHES = (
    EnvironmentVariable("ROS_SECURITY_ENABLE", "true"),
    EnvironmentVariable("ROS_SECURITY_STRATEGY", "Enforce"),
)


def keystore_variables(distro: str, layout: str) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.BuildType.keystore_variables`; an unknown distribution counts as later.

    Ardent and Bouncy look for the name of a node without its namespace: the variables are those of the namespace ``/``.
    """
    if _is_old(distro, layout):
        return _root(LAYOUTS[layout].enclaves), *_SWITCHES
    return EnvironmentVariable("ROS_SECURITY_KEYSTORE", "", is_path=True), *_SWITCHES


def enclave_variables(
    distro: str, layout: str, subject: str, files: Collection[str]
) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.BuildType.enclave_variables`."""
    del files
    if not _is_old(distro, layout):
        return *keystore_variables(distro, layout), EnvironmentVariable("ROS_SECURITY_ENCLAVE_OVERRIDE", subject)
    folder = f"{LAYOUTS[layout].enclaves}{subject}".strip("/")
    if distro in _WITH_NODE_DIRECTORY:
        own = EnvironmentVariable("ROS_SECURITY_NODE_DIRECTORY", folder, is_path=True)
        return *keystore_variables(distro, layout), own
    return _root(folder.rpartition("/")[0]), *_SWITCHES


def _root(folder: str) -> EnvironmentVariable:
    """Return the variable for the folder that has the folders of nodes, relative to the install space."""
    return EnvironmentVariable("ROS_SECURITY_ROOT_DIRECTORY", folder, is_path=True)


def _is_old(distro: str, layout: str) -> bool:
    """Tell whether nodes read the variables of before Foxy: ``flat`` is the layout of that time."""
    return layout == "flat" or distro in _BEFORE_FOXY
