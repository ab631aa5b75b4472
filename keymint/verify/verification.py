# SPDX-License-Identifier: Apache-2.0
"""Verify what one build type has built: ask each of its transports for every edge, and compare it with the policy.

Models of transports are asked in parts on a pool if that is worth it: each part has some of the subjects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple
from functools import cache, partial
from itertools import chain

from comarmor.values import Data, replace
from keymint.api import InstalledEnclave, LoadedPolicy, PolicyDecision, Tier, Transport
from keymint.api.graph import ConfusionMatrix, Edge, Graph, Object
from keymint.api.plugin_loader import Plugins
from keymint.host.pool import Pool
from keymint.verify.compare import Asking, EdgeComparison, TransportComparison
from keymint.verify.copies import Copies
from keymint.verify.endpoint_policy import EdgeRows, EndpointPolicy, label
from keymint.verify.scope import VerificationScope, common_objects, edges_of_graph, edges_of_policy, selected_rows
from keymint.verify.transports import Explainer, models

LEAST = 150_000
"""Edges, times models, for which a process of its own is worth its start."""


class Verification(Data):
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
    rows: EdgeRows
    labels: bytearray
    decide: Callable[[Edge], PolicyDecision]
    comparisons: tuple[EdgeComparison, ...]

    def edges(self) -> Iterator[Edge]:
        """Yield the edges, grouped by subject."""
        return chain.from_iterable(self.rows())


class VerificationPart(Data):
    """Some subjects to verify.

    Attributes:
        scope: the scope of these subjects.
        policy: the policy.
        graph: a graph with these subjects and the objects to ask about; None to ask about the objects of the policy.
        asking: how to ask.
        copies: the enclaves.
        common: objects of the policy that every subject is asked about, if there is no graph.
        transports: names of the models.
    """

    scope: VerificationScope
    policy: LoadedPolicy
    graph: Graph | None
    asking: Asking
    copies: Copies
    common: tuple[Object, ...] = ()
    transports: tuple[str, ...] = ()

    def rows(self) -> tuple[tuple[str, ...], EdgeRows]:
        """Return the subjects, and a function that yields all edges to ask about."""
        if self.graph is not None:
            subjects, rows = edges_of_graph(self.graph, self.scope)
            return subjects, selected_rows(rows, self.scope)
        rows = edges_of_policy(self.policy, replace(self.scope, enclaves=self.enclaves()), self.common)
        return tuple(self.scope.enclaves), selected_rows(rows, self.scope)

    def enclaves(self) -> Mapping[str, InstalledEnclave]:
        """Return the copies of the enclaves of these subjects."""
        return {subject: self.copies.enclaves[subject] for subject in self.scope.enclaves}

    def verified(self, plugins: Plugins, transports: Mapping[str, Transport]) -> Verification:
        """Compare transports with the policy.

        Raises:
            KeymintError: a transport does not work.
        """
        scope, asking = self.scope, self.asking
        subjects, rows = self.rows()
        policy = EndpointPolicy(self.policy, scope.namings)
        explain = Explainer(policy, transports, cache(partial(models, plugins, scope.build_type)), self.copies)
        labels = label(policy, rows(), lambda subject: asking.on_subject("policy", subject))
        alone = asking.tier is not Tier.EXCHANGE and scope.namings.keys() >= set(subjects)

        comparisons: list[EdgeComparison] = []
        for name, transport in transports.items():
            comparison = TransportComparison(name, transport, self.enclaves(), explain, asking)
            if alone and transport.ADMITS:
                comparison.all_endpoints(rows(), labels, policy)
            else:
                comparison.edges(chain.from_iterable(rows()), labels)
                if scope.select is None:
                    comparison.halves(rows(), labels, policy)
            comparisons.append(comparison.result())
        return Verification(scope.build_type, subjects, rows, labels, policy.decide, tuple(comparisons))

    def about(self, subjects: Sequence[str]) -> VerificationPart:
        """Return the part about some of the subjects."""
        graph = self.graph and replace(self.graph, subjects=tuple(subjects))
        asking = replace(self.asking, on_subject=_unseen)
        return replace(self, scope=self.scope.about(subjects), graph=graph, asking=asking)


def verify_part(plugins: Plugins, part: VerificationPart) -> tuple[bytes, tuple[EdgeComparison, ...]]:
    """Return the labels of the policy, and the comparison of each model.

    Raises:
        KeymintError: as of :meth:`VerificationPart.verified`.
    """
    verified = part.verified(plugins, {name: plugins.transport(name) for name in part.transports})
    return bytes(verified.labels), verified.comparisons


def verified_in_parts(
    pool: Pool, plugins: Plugins, whole: VerificationPart, transports: Mapping[str, Transport]
) -> Verification:
    """Verify one build type on copies of the enclaves; models are asked on a pool if that is worth it.

    Args:
        pool: where models are asked.
        plugins: the installed plugins.
        whole: all subjects to verify, without common objects and models.
        transports: the transports, by name.

    Raises:
        KeymintError: a transport does not work, or the pool is lost.
    """
    scope, policy, graph, asking = whole.scope, whole.policy, whole.graph, whole.asking
    modelled = tuple(name for name, each in transports.items() if each.usable().names_rules)
    common = () if graph else common_objects(policy, scope)
    whole = replace(whole, common=common, transports=modelled)
    subjects, rows = whole.rows()
    objects = len(graph.objects) if graph else len(common)
    divided = pool.parts(subjects, -(-LEAST // max(1, objects * len(modelled))))
    if len(divided) < 2:  # noqa: PLR2004 - nothing to do at the same time
        return whole.verified(plugins, transports)
    others = {name: each for name, each in transports.items() if name not in modelled}
    compared = {each.transport: each for each in (whole.verified(plugins, others).comparisons if others else ())}
    labels = bytearray()
    comparisons: list[tuple[EdgeComparison, ...]] = []
    tasks = map(whole.about, divided)
    for each, (own_labels, of_models) in zip(divided, pool.map(partial(verify_part, plugins), tasks), strict=True):
        labels += own_labels
        comparisons.append(of_models)
        for name in ("policy", *modelled):
            for subject in each:
                asking.on_subject(name, subject)
    for name, of_parts in zip(modelled, zip(*comparisons, strict=True), strict=True):
        compared[name] = _together(of_parts, asking.limit)
    decide = EndpointPolicy(policy, scope.namings).decide
    return Verification(scope.build_type, subjects, rows, labels, decide, tuple(compared[name] for name in transports))


def _unseen(_name: str, _subject: str) -> None:
    """Show no progress: a part is done as a whole."""


def _together(comparisons: Sequence[EdgeComparison], limit: int) -> EdgeComparison:
    """Return the comparison of all subjects, given those of the parts in the order of the subjects."""
    ends = [len(each.findings) - each.endpoints for each in comparisons]
    edges = [finding for each, end in zip(comparisons, ends, strict=True) for finding in each.findings[:end]][:limit]
    endpoints = [finding for each, end in zip(comparisons, ends, strict=True) for finding in each.findings[end:]]
    kept = endpoints[: limit - len(edges)]
    counts = [astuple(each.confusion) for each in comparisons]
    return replace(
        comparisons[0],
        confusion=ConfusionMatrix(*map(sum, zip(*counts, strict=True))),
        findings=(*edges, *kept),
        wrong={subject: count for each in comparisons for subject, count in each.wrong.items()},
        endpoints=len(kept),
    )
