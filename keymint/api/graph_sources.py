# SPDX-License-Identifier: Apache-2.0
"""Graph sources, which discover access graphs, and policy learners, which derive policies from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, runtime_checkable

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.api.graph import Edge, Graph
from keymint.api.policies import LoadedPolicy
from keymint.api.transports import Availability


@dataclass(frozen=True, slots=True)
class DiscoveredGraph:
    """An observed graph, and findings on it (e.g. how its subjects were named)."""

    graph: Graph
    diagnostics: tuple[Diagnostic, ...] = ()


class GraphSource(Protocol):
    """Discovers access graphs in a running system or in a capture file.

    Attributes:
        API: version of the plugin interface.
        CAPTURES: what :meth:`read` reads, for messages, e.g. ``XML of an administration console``.
    """

    API: str
    CAPTURES: str

    def usable(self) -> Availability:
        """Return whether a running system can be observed on this machine; never raises."""

    def observe(self, domain: int, go_on: Callable[[], bool], names: Mapping[str, str]) -> DiscoveredGraph:
        """Observe a domain, and return its graph in the transport's terms (objects of kind ``topic``).

        An empty graph comes with a diagnostic that says where to look.

        Args:
            domain: domain id.
            go_on: polled; the observation ends when it returns False.
            names: subjects by an identifier in the running system, or the beginning of one, which override discovered
                names.

        Raises:
            KeymintError: software that the observation needs is missing or fails.
        """

    def recognises(self, content: bytes) -> bool:
        """Whether a file is a capture that :meth:`read` can read."""

    def read(self, content: bytes, name: str, names: Mapping[str, str]) -> DiscoveredGraph:
        """Return the graph in a capture, in the transport's terms.

        Args:
            content: the file.
            name: its path as the user would type it, for messages.
            names: as for :meth:`observe`.

        Raises:
            KeymintError: with ``file:line`` of the defect.
        """

    def interpret(self, graph: Graph, *, fold: bool) -> Graph:
        """Translate a graph into application names; edges that have none, or are translated already, stay unchanged.

        Args:
            graph: objects of any kind.
            fold: True to merge complete sets of parts into composite permissions, False to split these into parts.
        """


@dataclass(frozen=True, slots=True)
class LearnedPolicy:
    """A policy learned from a graph.

    Attributes:
        document: the policy; empty if no rule is missing.
        fragments: files that it includes, by name in the requested folder.
        missing: edges of the graph that the document allows and the existing policy does not.
        conflicts: edges that a DENY rule of the existing policy denies, so that no new rule can allow them.
        unused: rules of the existing policy that no edge of the graph uses.
        notes: where an expression of the document stands for more than a name of the graph.
    """

    document: bytes
    fragments: Mapping[str, bytes]
    missing: tuple[Edge, ...]
    conflicts: tuple[Diagnostic, ...] = ()
    unused: tuple[Diagnostic, ...] = ()
    notes: tuple[Diagnostic, ...] = ()


@runtime_checkable
class PolicyLearner(Protocol):
    """Optional capability of a policy type: learns a policy from a graph."""

    def learn(self, graph: Graph, existing: LoadedPolicy | None, fragments: str) -> LearnedPolicy:
        """Return the smallest policy that, with the existing one, allows every edge of a graph.

        Args:
            graph: the observed edges.
            existing: a policy of the same type that remains in force.
            fragments: folder, relative to the policy, for included files; empty for a single document.

        Raises:
            KeymintError: the policy format cannot express an edge.
        """
