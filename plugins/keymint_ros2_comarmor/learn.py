# SPDX-License-Identifier: Apache-2.0
"""Learn the smallest ComArmor policy that allows a graph, as aa-genprof generates AppArmor profiles.

With the learned policy, a subject may do exactly what its edges require. An edge on an action or parameter requires all
its parts, and an endpoint in several partitions requires each of them.
"""

from __future__ import annotations

from keymint_comarmor.loaded import ComArmorPolicy

from keymint.api import LearnedPolicy, LoadedPolicy
from keymint.errors import KeymintError
from keymint.graph import Edge, Graph
from keymint_ros2_comarmor.common_parts import share
from keymint_ros2_comarmor.learned_document import document, fragment
from keymint_ros2_comarmor.learned_rules import needs_of
from keymint_ros2_comarmor.review import conflict, unused


def learn(graph: Graph, existing: LoadedPolicy | None, fragments: str) -> LearnedPolicy:
    """Return the rules that a graph needs in addition to an existing policy; see :class:`keymint.api.PolicyLearner`.

    Raises:
        KeymintError: the existing policy is not of this type.
    """
    if existing is not None and not isinstance(existing, ComArmorPolicy):
        raise KeymintError("the existing policy is not a ComArmor policy", code="policy-type")
    policy = existing.policy if existing else None
    missing: list[Edge] = []
    conflicts = []
    for edge in graph.edges:
        if policy is None:
            missing.append(edge)
            continue
        requested = edge.object
        decision = policy.decide(edge.subject, requested.kind, edge.permission, requested.name, requested.partitions)
        if decision.allowed:
            continue
        if denied := conflict(edge, decision):
            conflicts.append(denied)
        else:
            missing.append(edge)
    subjects = [each for each in graph.subjects if policy is None or not policy.applicable(each)]
    granted = needs_of(missing)
    needs = {subject: granted.get(subject, set()) for subject in sorted({*subjects, *granted})}
    parts = share(needs) if fragments else ()
    return LearnedPolicy(
        document=document(needs, parts, fragments, _note(graph)) if needs else b"",
        fragments={part.name: fragment(part) for part in parts},
        missing=tuple(missing),
        conflicts=tuple(dict.fromkeys(conflicts)),
        unused=tuple(unused(policy, graph)) if policy else (),
    )


def _note(graph: Graph) -> str:
    """Return a comment on the DDS domains of a graph, which a policy cannot express; empty for the default domain."""
    domains = sorted({edge.domain for edge in graph.edges})
    if domains in ([], [0]):
        return ""
    return f"Learned in DDS domain {', '.join(map(str, domains))}; this document holds no domain: its workspace does."
