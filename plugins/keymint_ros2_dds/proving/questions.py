# SPDX-License-Identifier: Apache-2.0
"""What is to be proven about a permissions document."""

from __future__ import annotations

from collections.abc import Callable

from comarmor.values import dataclass
from keymint.api import DomainRange
from keymint.ir import SubjectRules
from keymint_ros2_dds.lowering.lower import Lowered
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance
from keymint_ros2_dds.reading.signed_permissions import PermissionsDocument


@dataclass(frozen=True, slots=True)
class ProofSpec:
    """What a permissions document must permit, and how long a proof may take.

    Attributes:
        subject_name: the identity's, in the order of RFC 2253, e.g. ``CN=/talker,OU=0f``.
        rules: the policy's rules for the subject.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the policy applies.
        states: how many states a comparison may visit.
        go_on: called repeatedly; a comparison ends as unknown when it returns False.
    """

    subject_name: str
    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]
    states: int
    go_on: Callable[[], bool]


@dataclass(frozen=True, slots=True)
class ProofQuestion:
    """A permissions document, and what it must permit.

    Attributes:
        document: the document.
        spec: what it must permit.
        lowered: its rules in terms of DDS, from :func:`keymint_ros2_dds.lowering.lower.lower`.
        governance: the governance beside it; None puts every topic, and joining, under access control.
    """

    document: PermissionsDocument
    spec: ProofSpec
    lowered: Lowered
    governance: EnclaveGovernance | None = None
