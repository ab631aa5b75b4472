# SPDX-License-Identifier: Apache-2.0
"""Transports with participants of a real vendor: their tiers, and the build of their probe programs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import ClassVar

from keymint.api import Availability, Enclave, Environment, Tier, Verdict
from keymint.api.graph import Column, Edge
from keymint.errors import KeymintError
from keymint.host.vendor_process import MissingVendorError, VendorTransport
from keymint_ros2_dds.decision import CYCLONEDDS_0_10, FASTDDS_2_9, FASTDDS_3_3, Variation
from keymint_ros2_dds.transports import admission, enclave_files
from keymint_ros2_dds.transports.admission import Opener
from keymint_ros2_dds.transports.delivery import exchange
from keymint_ros2_dds.transports.enclave_model import EnclaveModels
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.participants import CycloneDDS, FastDDS, Vendor
from keymint_ros2_dds.vendors.probe_builds import inherited_variables, unpacked_version


class ParticipantsTransport(VendorTransport):
    """Implements :class:`keymint.api.Transport` with participants of a vendor.

    Attributes:
        NAME: the transport's name.
        MODEL: the model of the vendor, to explain what it decides.
        VENDOR: how participants are started.
        PROBE: how to build their program.
        VERSION: the header and macro of the vendor's version.
        NONCONFORMING: how to build the library that makes a participant ignore its own permissions.
        UNPACKED: versions in the cache, the best first, if it is not the version of the machine; used only when named.
    """

    NAME: ClassVar[str]
    MODEL: ClassVar[Variation]
    VENDOR: ClassVar[type[CycloneDDS | FastDDS]]
    PROBE: ClassVar[probe_builds.Probe]
    VERSION: ClassVar[tuple[str, str]]
    NONCONFORMING: ClassVar[probe_builds.Probe]
    UNPACKED: ClassVar[tuple[str, ...]] = ()

    def __init__(self, environment: Environment) -> None:
        super().__init__(environment)
        self._vendors: dict[bool, Vendor] = {}

    def _installed(self) -> Availability:
        """Look for the libraries, compilers and headers that the tiers need.

        Raises:
            MissingVendorError: one that every tier needs is missing.
        """
        if self.UNPACKED:
            version = unpacked_version(self._environment.cache, self.UNPACKED).version
            self.PROBE.compiler(self._environment.variables)
            return Availability(usable=True, version=version, tiers=tuple(Tier), by_default=False)
        version = self.PROBE.version(*self.VERSION, self._environment.variables)
        return Availability(usable=True, version=version, tiers=tuple(Tier))

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        self.usable().require(tier, self.NAME)
        models = EnclaveModels(enclaves, self._environment, keep_all=tier is Tier.EXCHANGE)
        if tier is not Tier.EXCHANGE:
            return admission.edge_verdicts(self._opener(tier), self.MODEL, models, edges)
        vendor = self._vendor(nonconforming=True)
        for enclave in enclaves:
            enclave_files.refuse_unusable_key(enclave)
        return exchange(vendor, self.MODEL, models, edges)

    def admitted(self, enclave: Enclave, endpoints: Column, tier: Tier) -> bytes:
        """See :meth:`keymint.api.EndpointTransport.admitted`."""
        opener, models = self._opener(tier), EnclaveModels([enclave], self._environment)
        admitted = bytearray(len(endpoints.requests))
        for domain in {each.domain for each in endpoints.requests}:
            creatable = [
                at
                for at, each in enumerate(endpoints.requests)
                if each.domain == domain and not admission.name_defect(each)
            ]
            named = [endpoints.requests[at] for at in creatable]
            answers = admission.endpoint_admissions(opener, models, enclave.subject, domain, named)
            for at, allowed in zip(creatable, answers, strict=False):
                admitted[at] = allowed
        return bytes(admitted)

    def _opener(self, tier: Tier) -> Opener:
        """Return what is asked at a tier without data exchange; a vendor that needs a participant has one for both."""
        del tier
        return partial(admission.participant, self._vendor(nonconforming=False))

    def _vendor(self, *, nonconforming: bool) -> Vendor:
        """Return the vendor with its built programs; the compiler is asked once whether they are up to date."""
        if nonconforming not in self._vendors:
            cache, environment = self._environment.cache / "probes", inherited_variables(self._environment.variables)
            probe, library, version = self.PROBE, self.NONCONFORMING, None
            try:
                if self.UNPACKED:
                    version = unpacked_version(self._environment.cache, self.UNPACKED)
                    probe, library = version.built(probe), version.built(library)
                self._vendors[nonconforming] = self.VENDOR(
                    probe.build(cache, environment),
                    environment,
                    library.build(cache, environment) if nonconforming else None,
                    version,
                )
            except (MissingVendorError, OSError) as error:
                raise KeymintError(str(error), code="transport-unusable") from None
        return self._vendors[nonconforming]


class FastDDSTransport(ParticipantsTransport):
    """Fast DDS 2.9; its access control cannot be asked without a participant: *decision* and *admission* are one."""

    NAME = "fastdds"
    MODEL = FASTDDS_2_9
    VENDOR = FastDDS
    PROBE = probe_builds.FASTDDS
    VERSION = ("fastrtps/config.h", "FASTRTPS_VERSION_STR")
    NONCONFORMING = probe_builds.FASTDDS_NONCONFORMING


class FastDDS3Transport(FastDDSTransport):
    """Fast DDS 3, unpacked into the cache."""

    NAME = "fastdds-3"
    MODEL = FASTDDS_3_3
    PROBE = probe_builds.FASTDDS_3
    UNPACKED = ("fastdds-3.3.0", "fastdds-3.1.2")


class CycloneDDS0105Transport(ParticipantsTransport):
    """Cyclone DDS 0.10.5, unpacked into the cache: Keymint's process cannot load its access-control plugin."""

    NAME = "cyclonedds-0.10.5"
    MODEL = CYCLONEDDS_0_10
    VENDOR = CycloneDDS
    PROBE = probe_builds.CYCLONEDDS
    NONCONFORMING = probe_builds.CYCLONEDDS_NONCONFORMING
    UNPACKED = ("cyclonedds-0.10.5",)
