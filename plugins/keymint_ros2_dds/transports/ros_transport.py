# SPDX-License-Identifier: Apache-2.0
"""The sourced ROS 2: a stand-in node for each enclave creates, or is refused, what a node of the user's would."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from comarmor.regex import lazy_regex
from keymint.api import Availability, Enclave, Tier, Verdict
from keymint.api.graph import Edge
from keymint.errors import KeymintError
from keymint.host.vendor_process import MissingVendorError, ProcessDiedError, ProcessFailedError, VendorTransport
from keymint_ros2_dds.decision.semantics import of_version
from keymint_ros2_dds.lowering.endpoints import endpoints, meanings
from keymint_ros2_dds.lowering.name_mapping import DISTROS
from keymint_ros2_dds.transports.enclave_model import EnclaveModels
from keymint_ros2_dds.vendors.participants import RefusedError
from keymint_ros2_dds.vendors.ros_network import PRIVATE, RosNetwork

_NAME = lazy_regex(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
"""The full names that rcl accepts (rmw, ``validate_full_topic_name.c``), but for two underscores in a row."""
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

    def asked(self, enclave: Enclave, edge: Edge) -> Sequence[Edge]:
        """See :meth:`keymint.api.Transport.asked`: a node creates nothing but topics and services of ROS."""
        found = meanings(enclave.distro, edge) if edge.object.kind == "topic" else (edge,)
        return [each for each in found if not each.object.partitions and _is_legal(each.object.name)]

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`. The reason of a denial is what ROS says, without the name."""
        self.usable().require(tier, "ros")
        models = EnclaveModels(enclaves, self._environment)
        if any(each.install.is_relative_to(PRIVATE) for each in enclaves):
            raise KeymintError(f"nodes see no file below {PRIVATE}", help="set TMPDIR", code="transport-unusable")
        try:
            with RosNetwork(self._environment.variables) as network:
                for (subject, domain), group in groupby(edges, key=lambda edge: (edge.subject, edge.domain)):
                    yield from self._labelled(network, models, models.enclaves[subject], domain, group)
        except (MissingVendorError, ProcessFailedError) as error:
            raise KeymintError(str(error), code="transport-failed") from None

    def _labelled(
        self, network: RosNetwork, models: EnclaveModels, enclave: Enclave, domain: int, edges: Iterable[Edge]
    ) -> Iterator[tuple[Edge, Verdict]]:
        """Yield the decisions on the edges of an enclave; a node that dies of one is started again for the next."""
        vendor, distro = "fastdds" if "rtps" in network.rmw else "cyclonedds", self._environment.variables["ROS_DISTRO"]
        variation = of_version(vendor, DISTROS.get(distro, {}).get(vendor, ""))
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
            modelled = model.verdict(variation, endpoints(enclave.distro, edge))
            alike = modelled.allowed == allowed
            reason = refusal or text.replace(edge.object.name, "…") or "it is created"
            where, deviation = (modelled.where, modelled.deviation) if alike else (model.place(), "")
            yield edge, Verdict(allowed, reason, where, deviation)
        if node is not None:
            node.reap()


def _is_legal(name: str) -> bool:
    return _NAME.fullmatch(name) is not None and "__" not in name and len(name) < _LONGEST
