# SPDX-License-Identifier: Apache-2.0
"""Transports with participants of a real vendor: their tiers, and the build of their probe programs.

The installed Cyclone DDS 0.10 also decides by its access-control plugin alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

from keymint.api import Availability, Enclave, Environment, Tier, Verdict
from keymint.api.graph import Column, Edge
from keymint.errors import KeymintError
from keymint.host.vendor_process import MissingVendorError, VendorTransport
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, FASTDDS_3_3, Variation
from keymint_ros2_dds.transports import enclave_files, trials
from keymint_ros2_dds.transports.enclave_model import EnclaveModel, EnclaveModels
from keymint_ros2_dds.transports.trials import Opener, exchange
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl
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
            return trials.edge_verdicts(self._opener(tier), self.MODEL, models, edges)
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
                if each.domain == domain and not trials.name_defect(each)
            ]
            named = [endpoints.requests[at] for at in creatable]
            answers = trials.endpoint_admissions(opener, models, enclave.subject, domain, named)
            for at, allowed in zip(creatable, answers, strict=False):
                admitted[at] = allowed
        return bytes(admitted)

    def _opener(self, tier: Tier) -> Opener:
        """Return what is asked at a tier without data exchange; a vendor that needs a participant has one for both."""
        del tier
        return partial(trials.participant, self._vendor(nonconforming=False))

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
