# SPDX-License-Identifier: Apache-2.0
"""Transports that ask the real software: participants of a vendor, or nodes of the ROS 2 that is sourced.

Participants have several tiers, and probe programs that are built for them. The installed Cyclone DDS 0.10 also decides
by its access-control plugin alone. A stand-in node of ROS 2 for each enclave creates, or is refused, what a node of the
user's would.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from comarmor.rules import is_fully_qualified
from comarmor.values import replace
from keymint.api import Availability, Environment, InstalledEnclave, Tier, Verdict
from keymint.api.graph import Column, Edge
from keymint.errors import KeymintError
from keymint.host.vendor_process import MissingVendorError, ProcessDiedError, ProcessFailedError, VendorTransport
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, FASTDDS_3_3, Variation, of_version
from keymint_ros2_dds.lowering.endpoints import endpoints, meanings
from keymint_ros2_dds.lowering.name_mapping import DISTROS
from keymint_ros2_dds.transports import enclave_files, trials
from keymint_ros2_dds.transports.enclave_model import EnclaveModel, EnclaveModels
from keymint_ros2_dds.transports.trials import Opener, exchange
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl
from keymint_ros2_dds.vendors.participants import CycloneDDS, FastDDS, FastDDS3, RefusedError, Vendor
from keymint_ros2_dds.vendors.probe_builds import unpacked_version
from keymint_ros2_dds.vendors.ros_network import PRIVATE, RosNetwork


class Software(NamedTuple):
    """What a transport asks.

    Attributes:
        model: the model of the vendor, to explain what it decides.
        vendor: how participants are started, and how their programs are built.
        version: the header and macro of the vendor's version on the machine.
        unpacked: versions in the cache, the best first, if it is not the machine's; then it is used only when named.
    """

    model: Variation
    vendor: type[Vendor]
    version: tuple[str, str] = ("", "")
    unpacked: tuple[str, ...] = ()


SOFTWARE: Mapping[str, Software] = {
    "cyclonedds": Software(CYCLONEDDS_0_10, CycloneDDS, ("dds/version.h", "DDS_VERSION")),
    "cyclonedds-0.10.5": Software(CYCLONEDDS_0_10, CycloneDDS, unpacked=("cyclonedds-0.10.5",)),
    "fastdds": Software(FASTDDS_2_9, FastDDS, ("fastrtps/config.h", "FASTRTPS_VERSION_STR")),
    "fastdds-3": Software(FASTDDS_3_3, FastDDS3, unpacked=("fastdds-3.3.0", "fastdds-3.1.2")),
}
"""By transport. Access control of Fast DDS cannot be asked without a participant: *decision* and *admission* are one.

So it is for Cyclone DDS 0.10.5, because Keymint's process cannot load the access-control plugin of another version.
"""


class ParticipantsTransport(VendorTransport):
    """A transport with participants of a vendor.

    Args:
        name: the transport's name.
        environment: the cache, and the environment variables of processes.
    """

    ADMITS = True

    def __init__(self, name: str, environment: Environment) -> None:
        super().__init__(environment)
        self._name = name
        self._software = SOFTWARE[name]
        self._vendors: dict[bool, Vendor] = {}

    def _installed(self) -> Availability:
        """Look for the libraries, compilers and headers that the tiers need.

        Raises:
            MissingVendorError: one that every tier needs is missing.
        """
        probe, variables = self._software.vendor.PROBE, self._environment.variables
        if self._software.unpacked:
            version = unpacked_version(self._environment.cache, self._software.unpacked).version
            probe.compiler(variables)
            return Availability(usable=True, version=version, tiers=tuple(Tier), by_default=False)
        return Availability(True, probe.version(*self._software.version, variables), tiers=tuple(Tier))

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        self.usable().require(tier, self._name)
        models = EnclaveModels(enclaves, self._environment, self._software.model, tier)
        if tier is not Tier.EXCHANGE:
            return trials.edge_verdicts(self._opener(tier), models, edges)
        vendor = self._vendor(nonconforming=True)
        for enclave in enclaves:
            enclave_files.refuse_unusable_key(enclave)
        return exchange(vendor, models, edges)

    def admitted(self, enclave: InstalledEnclave, endpoints: Column, tier: Tier) -> bytes:
        """See :meth:`keymint.api.Transport.admitted`."""
        opener, models = self._opener(tier), EnclaveModels([enclave], self._environment, self._software.model, tier)
        admitted = bytearray(len(endpoints.requests))
        for domain in {each.domain for each in endpoints.requests}:
            creatable = [
                at
                for at, each in enumerate(endpoints.requests)
                if each.domain == domain and not trials.name_defect(each)
            ]
            named = [endpoints.requests[at] for at in creatable]
            with opener(models, enclave.subject, domain) as opened:
                if not isinstance(opened, str):
                    answers = opened.allow((e.permission, e.object.name, e.object.partitions) for e in named)
                    for at, allowed in zip(creatable, answers, strict=True):
                        admitted[at] = allowed
        return bytes(admitted)

    def _opener(self, tier: Tier) -> Opener:
        """Return what is asked at a tier without data exchange; a vendor that needs a participant has one for both."""
        del tier
        return partial(trials.participant, self._vendor(nonconforming=False))

    def _vendor(self, *, nonconforming: bool) -> Vendor:
        """Return the vendor with its built programs; the compiler is asked once whether they are up to date."""
        if nonconforming not in self._vendors:
            cache, variables = self._environment.cache / "probes", self._environment.variables
            # None that configures a vendor.
            environment = {name: variables[name] for name in ("PATH", "LD_LIBRARY_PATH") if name in variables}
            vendor, unpacked = self._software.vendor, self._software.unpacked
            probe, library, version = vendor.PROBE, vendor.NONCONFORMING, None
            try:
                if unpacked:
                    version = unpacked_version(self._environment.cache, unpacked)
                    probe, library = version.built(probe), version.built(library)
                self._vendors[nonconforming] = vendor(
                    probe.build(cache, environment),
                    environment,
                    library.build(cache, environment) if nonconforming else None,
                    version,
                )
            except (MissingVendorError, OSError) as error:
                raise KeymintError(str(error), code="transport-unusable") from None
        return self._vendors[nonconforming]


class CycloneDDSTransport(ParticipantsTransport):
    """The installed Cyclone DDS, whose access-control plugin decides without participants."""

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
    with CycloneAccessControl(folder, domain) as access:
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


_LONGEST = 200
"""Bytes of a name; rmw accepts 247, less what follows the name of an action or of a node."""


class RosTransport(VendorTransport):
    """Nodes of the ROS 2 that the user has sourced."""

    SELECTIVE = True

    def _installed(self) -> Availability:
        """Look for a ROS 2 that is sourced, and can be run apart from all others; it is never used by default."""
        variables = self._environment.variables
        with RosNetwork(variables) as network:
            version = f"{variables['ROS_DISTRO']}, {network.rmw}"
        if not re.search("dds|rtps", version):
            return Availability(False, version, "this rmw implementation is not of DDS", "set RMW_IMPLEMENTATION")
        return Availability(usable=True, version=version, tiers=(Tier.ADMISSION,), by_default=False)

    def asked(self, enclave: InstalledEnclave, edge: Edge) -> Sequence[Edge]:
        """See :meth:`keymint.api.Transport.asked`: a node creates nothing but topics and services of ROS."""
        found = meanings(enclave.distro, edge) if edge.object.kind == "topic" else (edge,)
        return [each for each in found if not each.object.partitions and _is_legal(each.object.name)]

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`. The reason of a denial is what ROS says, without the name."""
        self.usable().require(tier, "ros")
        if any(each.install.is_relative_to(PRIVATE) for each in enclaves):
            raise KeymintError(f"nodes see no file below {PRIVATE}", help="set TMPDIR", code="transport-unusable")
        try:
            with RosNetwork(self._environment.variables) as network:
                vendor = "fastdds" if "rtps" in network.rmw else "cyclonedds"
                version = DISTROS.get(self._environment.variables["ROS_DISTRO"], {}).get(vendor, "")
                models = EnclaveModels(enclaves, self._environment, of_version(vendor, version), tier)
                for (subject, domain), group in groupby(edges, key=lambda edge: (edge.subject, edge.domain)):
                    yield from self._labelled(network, models, models.enclaves[subject], domain, group)
        except (MissingVendorError, ProcessFailedError) as error:
            raise KeymintError(str(error), code="transport-failed") from None

    def _labelled(
        self, network: RosNetwork, models: EnclaveModels, enclave: InstalledEnclave, domain: int, edges: Iterable[Edge]
    ) -> Iterator[tuple[Edge, Verdict]]:
        """Yield the decisions on the edges of an enclave; a node that dies of one is started again for the next."""
        model, node, refusal = models.of(enclave.subject, domain), None, ""
        for edge in edges:
            try:
                if not refusal:
                    node = node or network.node(enclave.install, enclave.subject, domain)
                    answer, text = node.ask("TRY", edge.permission, edge.object.name)
            except RefusedError as error:
                refusal = f"no node starts: {error}"
            except ProcessDiedError as error:
                answer, text, node = "DENIED", str(error).partition(":")[0], None
            allowed = not refusal and answer == "ALLOWED"
            modelled = model.verdict(models.variation, endpoints(enclave.distro, edge))
            alike = modelled.allowed == allowed
            reason = refusal or text.replace(edge.object.name, "…") or "it is created"
            where, deviation = (modelled.where, modelled.deviation) if alike else (model.place(), "")
            yield edge, Verdict(allowed, reason, where, deviation)
        if node is not None:
            node.reap()


def _is_legal(name: str) -> bool:
    """Return whether rcl accepts a full name (rmw, ``validate_full_topic_name.c``)."""
    return is_fully_qualified(name) and "__" not in name and len(name) < _LONGEST
