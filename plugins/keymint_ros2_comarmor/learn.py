"""From a graph to the smallest ComArmor policy that allows it, as aa-genprof makes AppArmor profiles.

The law: with the policy that is learned, a subject may do exactly what its edges say. What edges say is what they stand
for: an action or parameter its parts; an endpoint in several partitions each of these.
"""

from __future__ import annotations

import comarmor
from keymint.api import LearnedPolicy
from keymint.graph import Edge, Graph
from keymint_ros2_comarmor.common_parts import share
from keymint_ros2_comarmor.learned_rules import Needs, grant_of
from keymint_ros2_comarmor.review import conflict, unused
from keymint_ros2_comarmor.writing import document, fragment


def learn(graph: Graph, existing: comarmor.Policy | None, fragments: str) -> LearnedPolicy:
    """Return the policy that a graph needs beside an existing one; see :meth:`keymint.api.PolicyLearner.learn`."""
    missing: list[Edge] = []
    conflicts = []
    for edge in graph.edges:
        if existing is None:
            missing.append(edge)
            continue
        found = edge.object
        decision = existing.decide(edge.subject, found.kind, edge.permission, found.name, found.partitions)
        if decision.allowed:
            continue
        denied = conflict(edge, decision)
        if denied:
            conflicts.append(denied)
        else:
            missing.append(edge)
    subjects = [one for one in graph.subjects if existing is None or not existing.applicable(one)]
    needs: dict[str, Needs] = {one: {} for one in sorted({*subjects, *(edge.subject for edge in missing)})}
    for edge in missing:
        kind, name, permission, partitions = grant_of(edge)
        needs[edge.subject].setdefault((kind, name), {}).setdefault(permission, set()).update(partitions)
    parts = share(needs) if fragments else ()
    return LearnedPolicy(
        document=document(needs, parts, fragments, _note(graph)) if needs else b"",
        fragments={part.name: fragment(part) for part in parts},
        missing=tuple(missing),
        conflicts=tuple(dict.fromkeys(conflicts)),
        unused=tuple(unused(existing, graph)) if existing else (),
    )


def _note(graph: Graph) -> str:
    """Return a comment on the domains that a policy has no place for; empty where they are the usual one."""
    domains = sorted({edge.domain for edge in graph.edges})
    if domains in ([], [0]):
        return ""
    listed = ", ".join(map(str, domains))
    return f"Learned in DDS domain {listed}; this document holds no domain: its workspace does."
