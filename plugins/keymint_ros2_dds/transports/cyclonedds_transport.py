# SPDX-License-Identifier: Apache-2.0
"""The installed Cyclone DDS 0.10: its access-control plugin alone, participants, or data between processes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from keymint.api import Availability, Tier
from keymint.errors import KeymintError
from keymint.host.vendor_process import MissingVendorError
from keymint_ros2_dds.decision import CYCLONEDDS_0_10
from keymint_ros2_dds.transports import enclave_files
from keymint_ros2_dds.transports.admission import Opener
from keymint_ros2_dds.transports.enclave_model import EnclaveModel, EnclaveModels
from keymint_ros2_dds.transports.participants_transport import ParticipantsTransport
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl
from keymint_ros2_dds.vendors.participants import CycloneDDS


class CycloneDDSTransport(ParticipantsTransport):
    """Cyclone DDS, whose access-control plugin decides without participants."""

    NAME = "cyclonedds"
    MODEL = CYCLONEDDS_0_10
    VENDOR = CycloneDDS
    PROBE = probe_builds.CYCLONEDDS
    VERSION = ("dds/version.h", "DDS_VERSION")
    NONCONFORMING = probe_builds.CYCLONEDDS_NONCONFORMING

    def _installed(self) -> Availability:
        """Without compiler and headers only the tier *decision* is usable."""
        probe_builds.require_cyclone_plugins()
        try:
            availability = super()._installed()
        except MissingVendorError as error:
            return Availability(True, "0.10", error.reason, error.help, (Tier.DECISION,))
        return replace(availability, version=availability.version or "0.10")

    def _opener(self, tier: Tier) -> Opener:
        return _plugin if tier is Tier.DECISION else super()._opener(tier)


@contextmanager
def _plugin(models: EnclaveModels, subject: str, domain: int) -> Iterator[CycloneAccessControl | str]:
    """Yield the plugin with an enclave, or why it is refused.

    Some documents crash the process that gives them to Cyclone DDS; they are not given to it. The plugin sees no
    revocation list and no authority: whether the participant authenticates itself is what the model says.
    """
    folder, enclave_model = models.enclaves[subject].folder, models.of(subject, domain)
    if refusal := _refusal(folder, enclave_model):
        yield refusal
        return
    with CycloneAccessControl.of_enclave(folder, domain) as access:
        joins = access.valid and access.joins()
        yield access if joins else f"Cyclone DDS refuses the enclave: {access.reason}"


def _refusal(folder: Path, enclave_model: EnclaveModel) -> str:
    """Return why an enclave is not given to the plugin, or an empty text."""
    unauthenticated = enclave_model.unauthenticated(CYCLONEDDS_0_10)
    if unauthenticated:
        return f"Cyclone DDS refuses the enclave: {unauthenticated}"
    if enclave_model.documents is not None:
        return enclave_files.crash(enclave_model.documents.permissions)
    try:  # the plugin may accept a signature that Keymint does not
        return enclave_files.crash(enclave_files.unverified_permissions(folder))
    except KeymintError as error:
        return str(error)
