# SPDX-License-Identifier: Apache-2.0
"""Verify what one build type has built: ask each of its transports for every edge, and compare it with the policy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from itertools import chain

from comarmor.values import dataclass
from keymint.api import EndpointTransport, LoadedPolicy, PolicyDecision, Tier, Transport
from keymint.api.graph import Edge
from keymint.verify.compare import Asking, compare
from keymint.verify.compare_endpoints import compare_endpoints
from keymint.verify.endpoint_policy import EndpointPolicy, label
from keymint.verify.explain import Explainer
from keymint.verify.halves import with_halves
from keymint.verify.mismatch import Comparison
from keymint.verify.rows import EdgeRows
from keymint.verify.scope import VerificationScope


@dataclass(frozen=True, slots=True)
class Verification:
    """The transports of one build type, compared with the policy.

    Attributes:
        build_type: its name.
        subjects: the subjects of the edges.
        rows: returns the edges of each subject.
        labels: the policy's label of each edge: 1 allowed, 0 denied.
        decide: returns the decision of the policy on an edge, as this build type applies it.
        comparisons: the comparison of each transport.
    """

    build_type: str
    subjects: tuple[str, ...]
    rows: EdgeRows = field(repr=False)
    labels: bytearray = field(repr=False)
    decide: Callable[[Edge], PolicyDecision] = field(repr=False)
    comparisons: tuple[Comparison, ...]

    def edges(self) -> Iterator[Edge]:
        """Yield the edges, grouped by subject."""
        return chain.from_iterable(self.rows())


def verification(
    scope: VerificationScope,
    policy: LoadedPolicy,
    subjects: tuple[str, ...],
    rows: EdgeRows,
    transports: Mapping[str, Transport],
    find_models: Callable[[], Mapping[str, Transport]],
    asking: Asking,
) -> Verification:
    """Compare transports of a build type with the policy.

    Args:
        scope: the enclaves.
        policy: the policy.
        subjects: the subjects of the edges.
        rows: returns the edges of each subject; called for each transport and for the policy.
        transports: the transports, by name.
        find_models: returns simulated transports of the build type, to explain mismatches.
        asking: how to ask.

    Raises:
        KeymintError: a transport does not work.
    """
    endpoint_policy = EndpointPolicy(policy, scope.namings)
    explain = Explainer(endpoint_policy, transports, find_models)
    labels = label(endpoint_policy, rows(), lambda subject: asking.on_subject("policy", subject))

    def compared(name: str, transport: Transport) -> Comparison:
        alone = asking.tier is not Tier.EXCHANGE and scope.namings.keys() >= set(subjects)
        if alone and isinstance(transport, EndpointTransport):
            return compare_endpoints(name, transport, scope.enclaves, rows(), labels, endpoint_policy, explain, asking)
        edges = chain.from_iterable(rows())
        outcome = compare(name, transport, scope.enclaves, edges, labels, explain, asking)
        if scope.select is not None:
            return outcome
        return with_halves(outcome, transport, scope.enclaves, rows(), labels, endpoint_policy, explain, asking.limit)

    comparisons = tuple(compared(name, transport) for name, transport in transports.items())
    return Verification(scope.build_type, subjects, rows, labels, endpoint_policy.decide, comparisons)
