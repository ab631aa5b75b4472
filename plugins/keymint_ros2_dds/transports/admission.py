# SPDX-License-Identifier: Apache-2.0
"""Ask real participants of a vendor, each in its own process, which endpoints they may create."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import groupby

from keymint.api import Enclave, Verdict
from keymint.api.graph import Edge
from keymint.errors import KeymintError
from keymint.host.vendor_process import ProcessFailedError
from keymint_ros2_dds.decision import Variation
from keymint_ros2_dds.enclave_layout import reads_revocations
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.transports import enclave_files
from keymint_ros2_dds.transports.enclave_model import EnclaveModels
from keymint_ros2_dds.vendors.cyclone_access_control import AccessControl
from keymint_ros2_dds.vendors.participants import CycloneDDS, ProbeParticipant, RefusedError, System, Vendor


def unsayable(endpoint: Edge) -> str:
    """Return why no participant can create an endpoint of this name, or an empty text."""
    if not "".join((endpoint.object.name, *endpoint.object.partitions)).isprintable():
        return "the name has a character that no DDS topic has"
    return "" if endpoint.object.name else "no DDS topic has an empty name"


@contextmanager
def participants(vendor: Vendor, subject: str) -> Iterator[System]:
    """Open a system of participants, which tests what a subject may do.

    Raises:
        KeymintError: a process of the vendor fails.
    """
    try:
        with System(vendor) as system:
            yield system
    except ProcessFailedError as error:
        raise KeymintError(f"{subject}: {error}", code="transport-failed") from None


def joined(system: System, enclave: Enclave, domain: int, *, conforming: bool = True) -> ProbeParticipant:
    """Return a participant of an enclave; see :meth:`System.open`.

    Raises:
        RefusedError: the vendor refuses it, or its process would crash.
    """
    if isinstance(system.vendor, CycloneDDS):
        with suppress(KeymintError):  # what Keymint cannot read, the vendor judges
            if crash := enclave_files.crash(enclave_files.unverified_permissions(enclave.folder)):
                raise RefusedError(crash)
    revocations = reads_revocations(enclave.distro)
    return system.open(enclave.folder, domain, conforming=conforming, revocations=revocations)


def admission(
    vendor: Vendor, model: Variation, models: EnclaveModels, edges: Iterable[Edge]
) -> Iterator[tuple[Edge, Verdict]]:
    """Yield whether real participants may have each edge; one participant per enclave and domain, one at a time.

    Args:
        vendor: the vendor, with its built probe.
        model: the model of the vendor.
        models: the enclaves.
        edges: grouped by subject.

    Raises:
        KeymintError: an enclave is missing, or the vendor's process fails.
    """
    for (subject, domain), group in groupby(edges, key=lambda edge: (edge.subject, edge.domain)):
        enclave, enclave_model = models.enclaves[subject], models.of(subject, domain)
        enclave_files.refuse_unusable_key(enclave)
        with participants(vendor, subject) as system:
            try:
                participant = joined(system, enclave, domain)
            except RefusedError as error:
                reason = f"the participant is refused: {error}"
                refused = Verdict(allowed=False, reason=reason, where=enclave_model.place())
                yield from ((edge, refused) for edge in group)
                continue
            for edge in group:
                needed = endpoints(enclave.distro, edge)
                yield edge, enclave_model.verdict(model, needed, asked(participant, needed))


def admitted(vendor: Vendor, enclave: Enclave, domain: int, endpoints: Sequence[Edge]) -> Sequence[bool]:
    """Return which endpoints a real participant may have; nothing if the participant is refused.

    Args:
        vendor: the vendor, with its built probe.
        enclave: the enclave.
        domain: DDS domain id.
        endpoints: edges of kind ``topic`` whose names can be said.

    Raises:
        KeymintError: the vendor's process fails.
    """
    enclave_files.refuse_unusable_key(enclave)
    topics = [(each.permission, each.object.name, *each.object.partitions) for each in endpoints]
    with participants(vendor, enclave.subject) as system:
        try:
            return joined(system, enclave, domain).allow(topics)
        except RefusedError:
            return ()


def asked(vendor: ProbeParticipant | AccessControl, needed: Iterable[Edge]) -> Iterator[tuple[bool, str]]:
    """Yield whether a vendor admits each endpoint, and why not."""
    for endpoint in needed:
        reason, topic = unsayable(endpoint), endpoint.object
        yield (False, reason) if reason else vendor.ask(endpoint.permission, topic.name, topic.partitions)
