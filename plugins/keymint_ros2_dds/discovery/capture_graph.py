# SPDX-License-Identifier: Apache-2.0
"""Make a graph of a capture of a DDS domain."""

from __future__ import annotations

from collections.abc import Mapping

from comarmor.errors import Diagnostic
from keymint.api import DiscoveredGraph
from keymint.api.graph import Edge, Graph
from keymint.api.graph_json import legal_text
from keymint_ros2_dds.discovery.capture import Capture, DiscoveredEndpoint
from keymint_ros2_dds.discovery.participant_names import name_participants


def discovered_graph(capture: Capture, names: Mapping[str, str]) -> DiscoveredGraph:
    """Return a capture as a graph whose objects are DDS topics.

    Args:
        capture: the capture.
        names: subjects that the user gives, by GUID or the beginning of one.
    """
    sound = [seen for seen in capture.endpoints if _sound(seen)]
    subjects, diagnostics = name_participants(capture.participants, sound, names)
    domains = {participant.guid: participant.domain for participant in capture.participants}
    diagnostics += [
        Diagnostic.warning(
            "endpoint-odd",
            f"an endpoint of {subjects[guid]} is left out: its topic, type or partition is no name, or too long",
            subject=subjects[guid],
        )
        for guid in sorted({seen.participant for seen in capture.endpoints if not _sound(seen)})
    ]
    edges = [
        Edge(subjects[seen.participant], seen.permission, seen.object, domains[seen.participant]) for seen in sound
    ]
    types = [(seen.object, seen.type) for seen in sound if seen.type]
    return DiscoveredGraph(Graph.of(edges, subjects.values(), types), tuple(diagnostics))


def _sound(seen: DiscoveredEndpoint) -> bool:
    """Tell whether an endpoint's names are legal; anyone on the network can announce anything."""
    return bool(seen.topic) and all(map(legal_text, (seen.topic, seen.type, *seen.partitions)))
