# SPDX-License-Identifier: Apache-2.0
"""The installed Cyclone DDS 0.10: its access-control plugin alone, participants, or data between processes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import groupby
from operator import attrgetter
from pathlib import Path

from keymint.api import Availability, Enclave, Tier, Verdict
from keymint.api.graph import Edge
from keymint.errors import KeymintError
from keymint.host.vendor_process import MissingVendorError
from keymint_ros2_dds.decision import CYCLONEDDS_0_10
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.transports import admission, enclave_files
from keymint_ros2_dds.transports.enclave_model import EnclaveModel, EnclaveModels
from keymint_ros2_dds.transports.participants_transport import RealTransport
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.cyclone_access_control import AccessControl
from keymint_ros2_dds.vendors.participants import CycloneDDS


class CycloneDDSTransport(RealTransport):
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

    def _decision(self, models: EnclaveModels, edges: Iterable[Edge]) -> Iterator[tuple[Edge, Verdict]]:
        """Ask the access-control plugin about each enclave; only those of one subject are open at a time."""
        for subject, group in groupby(edges, key=attrgetter("subject")):
            enclave, opened = models.enclaves[subject], dict[int, "AccessControl | str"]()
            with ExitStack() as stack:
                for edge in group:
                    enclave_model = models.of(subject, edge.domain)
                    if edge.domain not in opened:
                        opened[edge.domain] = _open(enclave_model, enclave.folder, edge.domain, stack)
                    access = opened[edge.domain]
                    if isinstance(access, str):
                        yield edge, Verdict(allowed=False, reason=access, where=enclave_model.place())
                        continue
                    needed = endpoints(enclave.distro, edge)
                    yield edge, enclave_model.verdict(self.MODEL, needed, admission.asked(access, needed))

    def _decide(self, enclave: Enclave, domain: int, endpoints: Sequence[Edge]) -> Iterable[bool]:
        enclave_model = EnclaveModel(enclave, self._environment, domain)
        with ExitStack() as stack:
            access = _open(enclave_model, enclave.folder, domain, stack)
            if isinstance(access, str):
                return ()
            return [access.allows(each.permission, each.object.name, each.object.partitions) for each in endpoints]


def _open(enclave_model: EnclaveModel, folder: Path, domain: int, stack: ExitStack) -> AccessControl | str:
    """Return the plugin with an enclave, or why it is refused.

    Some documents crash the process that gives them to Cyclone DDS; they are not given to it. The plugin sees no
    revocation list and no authority: whether the participant authenticates itself is what the model says.
    """
    unauthenticated = enclave_model.unauthenticated(CYCLONEDDS_0_10)
    if unauthenticated:
        return f"Cyclone DDS refuses the enclave: {unauthenticated}"
    if enclave_model.documents is not None:
        permissions = enclave_model.documents.permissions
    else:
        try:  # the plugin may accept a signature that Keymint does not
            permissions = enclave_files.unverified_permissions(folder)
        except KeymintError as error:
            return str(error)
    if crash := enclave_files.crash(permissions):
        return crash
    access = stack.enter_context(AccessControl.of_enclave(folder, domain))
    if not access.valid or not access.joins():
        return f"Cyclone DDS refuses the enclave: {access.reason}"
    return access
