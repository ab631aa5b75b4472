# SPDX-License-Identifier: Apache-2.0
"""Learn the smallest ComArmor policy that allows a graph, as aa-genprof generates AppArmor profiles.

With the learned policy, a subject may do exactly what its edges require. An edge on an action or parameter requires all
its parts, and an endpoint in several partitions requires each of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from keymint_comarmor.loaded import ComArmorPolicy

from comarmor.errors import Diagnostic
from keymint.api import LearnedPolicy, LoadedPolicy
from keymint.api.generated_names import generalised, is_generated
from keymint.api.graph import Edge, Graph
from keymint.errors import KeymintError
from keymint_ros2_comarmor.common_parts import share
from keymint_ros2_comarmor.learned_document import document, fragment
from keymint_ros2_comarmor.learned_rules import needs_of
from keymint_ros2_comarmor.review import conflict, unused_rule_notes


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
        unused=tuple(unused_rule_notes(policy, graph)) if policy else (),
        notes=tuple(_generated(missing, needs)),
    )


def _generated(edges: Iterable[Edge], subjects: Iterable[str]) -> Iterator[Diagnostic]:
    """Yield a note for each expression that matches more than its name, and for each subject with a generated name."""
    told: set[str] = set()
    for edge in edges:
        expression, what = generalised(edge.object.name, edge.object.kind)
        if what and expression not in told:
            told.add(expression)
            message = f"{expression} stands for {edge.object.name}: {what} changes with each start"
            yield Diagnostic.note("learn-generated", message, subject=edge.subject)
    for subject in filter(is_generated, subjects):
        message = f"the name of {subject} changes with each start, so its profile is about no enclave"
        help_ = "record it with its enclave, or name it: keymint discover --subject ID=NAME"
        yield Diagnostic.note("learn-generated", message, None, help_, subject)


def _note(graph: Graph) -> str:
    """Return a comment on the DDS domains of a graph, which a policy cannot express; empty for the default domain."""
    domains = sorted({edge.domain for edge in graph.edges})
    if domains in ([], [0]):
        return ""
    return f"Learned in DDS domain {', '.join(map(str, domains))}; this document holds no domain: its workspace does."
