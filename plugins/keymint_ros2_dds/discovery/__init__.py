"""Graph source ``keymint_ros2_dds``: graphs of ROS 2 nodes, observed on DDS or captured by RTI Admin Console."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from keymint.api import API_VERSION, Availability, DiscoveredGraph
from keymint.graph import Graph

__all__ = ["DdsGraphs", "graph_source"]


class DdsGraphs:
    """Implements :class:`keymint.api.GraphSource` for ROS 2 on DDS."""

    API = API_VERSION

    def usable(self) -> Availability:
        """Return whether Cyclone DDS, the observer, is installed."""
        from keymint_ros2_dds.discovery import cyclonedds_observer  # noqa: PLC0415 - listing plugins must not load a vendor

        return cyclonedds_observer.usable()

    def observe(self, domain: int, go_on: Callable[[], bool], names: Mapping[str, str]) -> DiscoveredGraph:
        """See :func:`keymint_ros2_dds.discovery.cyclonedds_observer.observe`."""
        from keymint_ros2_dds.discovery import cyclonedds_observer, to_graph  # noqa: PLC0415

        return to_graph.discovered(cyclonedds_observer.observe(domain, go_on), names)

    def recognises(self, content: bytes) -> bool:
        """See :func:`keymint_ros2_dds.discovery.admin_console.recognises`."""
        from keymint_ros2_dds.discovery import admin_console  # noqa: PLC0415

        return admin_console.recognises(content)

    def read(self, content: bytes, name: str, names: Mapping[str, str]) -> DiscoveredGraph:
        """See :func:`keymint_ros2_dds.discovery.admin_console.read`."""
        from keymint_ros2_dds.discovery import admin_console, to_graph  # noqa: PLC0415

        return to_graph.discovered(admin_console.read(content, name), names)

    def interpret(self, graph: Graph, *, fold: bool) -> Graph:
        """See :func:`keymint_ros2_dds.discovery.interpret.interpret`."""
        from keymint_ros2_dds.discovery.interpret import interpret  # noqa: PLC0415

        return interpret(graph, fold=fold)


graph_source = DdsGraphs()
