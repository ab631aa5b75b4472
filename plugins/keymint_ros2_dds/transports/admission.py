# SPDX-License-Identifier: Apache-2.0
"""Ask a vendor which endpoints an enclave may create: a real participant in its own process, or whatever decides."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
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
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl
from keymint_ros2_dds.vendors.participants import CycloneDDS, ProbeParticipant, RefusedError, System, Vendor


def name_defect(endpoint: Edge) -> str:
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


def open_participant(system: System, enclave: Enclave, domain: int, *, conforming: bool = True) -> ProbeParticipant:
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


@contextmanager
def participant(vendor: Vendor, models: EnclaveModels, subject: str, domain: int) -> Iterator[ProbeParticipant | str]:
    """Open a real participant of an enclave in a process of its own, or tell why it is refused; see :data:`Opener`.

    Raises:
        KeymintError: the enclave is missing, or a process of the vendor fails.
    """
    enclave = models.enclaves[subject]
    enclave_files.refuse_unusable_key(enclave)
    with participants(vendor, subject) as system:
        opened: ProbeParticipant | str
        try:
            opened = open_participant(system, enclave, domain)
        except RefusedError as error:
            opened = f"the participant is refused: {error}"
        yield opened


Opener = Callable[[EnclaveModels, str, int], AbstractContextManager[ProbeParticipant | CycloneAccessControl | str]]
"""Opens the enclave of a subject in a domain, to ask it about endpoints; a text says why the vendor refuses it."""


def edge_verdicts(
    opener: Opener, model: Variation, models: EnclaveModels, edges: Iterable[Edge]
) -> Iterator[tuple[Edge, Verdict]]:
    """Yield whether a vendor allows each edge; the enclaves are opened one at a time.

    Args:
        opener: opens an enclave.
        model: the model of the vendor.
        models: the enclaves.
        edges: grouped by subject.

    Raises:
        KeymintError: an enclave is missing, or the vendor's process fails.
    """
    for (subject, domain), group in groupby(edges, key=lambda edge: (edge.subject, edge.domain)):
        enclave, enclave_model = models.enclaves[subject], models.of(subject, domain)
        with opener(models, subject, domain) as opened:
            for edge in group:
                if isinstance(opened, str):
                    yield edge, Verdict(allowed=False, reason=opened, where=enclave_model.place())
                else:
                    needed = endpoints(enclave.distro, edge)
                    yield edge, enclave_model.verdict(model, needed, answers(opened, needed))


def endpoint_admissions(
    opener: Opener, models: EnclaveModels, subject: str, domain: int, endpoints: Sequence[Edge]
) -> Sequence[bool]:
    """Return which endpoints a vendor allows; nothing if it refuses the enclave.

    Args:
        opener: opens an enclave.
        models: the enclaves.
        subject: the enclave's.
        domain: DDS domain id.
        endpoints: edges of kind ``topic`` whose names can be said.

    Raises:
        KeymintError: the vendor's process fails.
    """
    topics = [(each.permission, each.object.name, each.object.partitions) for each in endpoints]
    with opener(models, subject, domain) as opened:
        return () if isinstance(opened, str) else opened.allow(topics)


def answers(vendor: ProbeParticipant | CycloneAccessControl, needed: Iterable[Edge]) -> Iterator[tuple[bool, str]]:
    """Yield whether a vendor admits each endpoint, and why not."""
    for endpoint in needed:
        reason, topic = name_defect(endpoint), endpoint.object
        yield (False, reason) if reason else vendor.ask(endpoint.permission, topic.name, topic.partitions)
