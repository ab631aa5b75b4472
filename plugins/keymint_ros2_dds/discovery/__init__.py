# SPDX-License-Identifier: Apache-2.0
"""Graph source ``keymint_ros2_dds``: graphs of ROS 2 nodes, observed on DDS or captured by RTI Admin Console."""

from __future__ import annotations

from keymint.api import API_VERSION, GraphSource, lazy

__all__ = ["DdsGraphs", "graph_source"]


class DdsGraphs(GraphSource):
    """Graphs of ROS 2 on DDS; listing plugins must not load a vendor."""

    API = API_VERSION
    CAPTURES = "XML of RTI Admin Console"

    usable = lazy("keymint_ros2_dds.discovery.cyclonedds_observer:library_availability")
    observe = lazy("keymint_ros2_dds.discovery.cyclonedds_observer:observe")
    recognises = lazy("keymint_ros2_dds.discovery.admin_console:recognises")
    read = lazy("keymint_ros2_dds.discovery.admin_console:read")
    interpret = lazy("keymint_ros2_dds.discovery.capture:interpret")


graph_source = DdsGraphs()
