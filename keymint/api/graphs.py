"""Graphs from the world, and policies from graphs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from comarmor.errors import Diagnostic
from keymint.api.policies import LoadedPolicy
from keymint.api.transports import Availability
from keymint.graph import Edge, Graph


@dataclass(frozen=True, slots=True)
class DiscoveredGraph:
    """A graph that was seen, and what is to be said of it (how subjects came by their names, say)."""

    graph: Graph
    diagnostics: tuple[Diagnostic, ...] = ()


class GraphSource(Protocol):
    """Finds semantic access graphs: in a running system, and in captures of one."""

    API: str

    def usable(self) -> Availability:
        """Tell whether a running system can be observed on this machine; never raises."""

    def observe(self, domain: int, go_on: Callable[[], bool], names: Mapping[str, str]) -> DiscoveredGraph:
        """Return what happens in a domain, in the transport's own terms (objects of kind ``topic``).

        Args:
            domain: DDS domain id.
            go_on: asked again and again; the observation ends when it returns False.
            names: subjects by GUID (hexadecimal, or the beginning of one), where the user knows better.

        Raises:
            KeymintError: what it takes is not installed, or does not work.
        """

    def recognises(self, content: bytes) -> bool:
        """Tell whether a file is a capture that :meth:`read` reads."""

    def read(self, content: bytes, name: str, names: Mapping[str, str]) -> DiscoveredGraph:
        """Return what a capture holds, in the transport's own terms.

        Args:
            content: the file.
            name: its path as the user would type it, for messages.
            names: as for :meth:`observe`.

        Raises:
            KeymintError: with ``file:line`` of the defect.
        """

    def interpret(self, graph: Graph, *, fold: bool) -> Graph:
        """Return a graph in the application's terms; what is in these already stays, what fits none stays as it is.

        Args:
            graph: objects of any kind.
            fold: put the parts of composite kinds together where all of them are there; else take these apart.
        """


@dataclass(frozen=True, slots=True)
class LearnedPolicy:
    """A policy that was learned from a graph.

    Attributes:
        document: the policy; empty when there is nothing to say.
        fragments: files that it includes, by name in the folder that was asked for.
        missing: edges of the graph that the document allows (and the existing policy does not).
        conflicts: edges that a rule of the existing policy denies, so that no addition allows them.
        unused: what the existing policy allows and no edge of the graph needs.
    """

    document: bytes
    fragments: Mapping[str, bytes]
    missing: tuple[Edge, ...]
    conflicts: tuple[Diagnostic, ...] = ()
    unused: tuple[Diagnostic, ...] = ()


@runtime_checkable
class PolicyLearner(Protocol):
    """What a policy type may offer beside :class:`PolicyType`: the policy that a graph needs."""

    def learn(self, graph: Graph, existing: LoadedPolicy | None, fragments: str) -> LearnedPolicy:
        """Return the smallest policy that, with the existing one, allows every edge of a graph.

        Args:
            graph: what subjects do.
            existing: a policy of the same type that stays in force.
            fragments: folder beside the policy for the files that it may include; empty for one document.

        Raises:
            KeymintError: the policy format cannot express an edge.
        """
