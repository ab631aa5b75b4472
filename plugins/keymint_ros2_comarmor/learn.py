# SPDX-License-Identifier: Apache-2.0
"""Learn the smallest ComArmor policy that allows a graph, as aa-genprof generates AppArmor profiles.

With the learned policy, a subject may do exactly what its edges require. An edge on an action or parameter requires all
its parts, and an endpoint in several partitions requires each of them. Rules that several subjects share move into
included files, where that makes the policy shorter. An existing policy is compared with the graph: edges that it
denies, and permissions that no edge uses, are reported.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from keymint_comarmor.loaded import ComArmorPolicy

import comarmor
from comarmor.errors import Diagnostic, Origin, Spot
from comarmor.language.attachments import parts as subject_parts
from comarmor.patterns.expression import matches
from comarmor.rules import parts
from comarmor.text import quote
from keymint.api import LearnedPolicy, LoadedPolicy
from keymint.api.graph import Edge, Graph, general_expression, is_generated
from keymint.errors import KeymintError
from keymint_ros2_comarmor.policy_documents import (
    INCLUDE_SIZE,
    CommonPart,
    Need,
    document,
    fold,
    fragment,
    literal,
    needs_of,
    profiles,
    templates,
)

_NAME = "common_{number}.xml"


def share(needs: Mapping[str, set[Need]]) -> tuple[CommonPart, ...]:
    """Return the common parts that make the policy shorter, in bytes of all its files.

    The needs that a group of subjects shares are one candidate. Larger groups are tried first.
    """
    remaining = {subject: set(own_needs) for subject, own_needs in needs.items()}
    parts: list[CommonPart] = []
    for _, shared in sorted(_candidates(remaining).items(), key=lambda item: (-len(item[0]), item[0])):
        covered = {subject: frozenset(by_template.values()) for subject, by_template in shared.items()}
        common = frozenset(next(iter(shared.values())))
        saved_bytes = -len(fragment(common))
        for subject, own_needs in covered.items():
            before, after = (
                len(profiles({"p": fold(map(literal, needs))}))
                for needs in (remaining[subject], remaining[subject] - own_needs)
            )
            saved_bytes += before - after - INCLUDE_SIZE
        if saved_bytes > 0:
            for subject, own_needs in covered.items():
                remaining[subject] -= own_needs
            parts.append(CommonPart(_NAME.format(number=len(parts) + 1), common, covered))
    return tuple(parts)


def _candidates(needs: Mapping[str, set[Need]]) -> dict[tuple[str, ...], dict[str, dict[Need, Need]]]:
    """Return the candidates by group of subjects: for each subject its needs by their common template."""
    holders: dict[Need, set[str]] = {}
    for subject, own_needs in needs.items():
        for need in own_needs:
            for template in templates(need, subject):
                holders.setdefault(template, set()).add(subject)
    groups: dict[tuple[str, ...], dict[str, dict[Need, Need]]] = {}
    for subject, own_needs in needs.items():
        for need in own_needs:
            best = max(templates(need, subject), key=lambda template: len(holders[template]))
            if len(holders[best]) > 1:
                groups.setdefault(tuple(sorted(holders[best])), {}).setdefault(subject, {})[best] = need
    shared: dict[tuple[str, ...], dict[str, dict[Need, Need]]] = {}
    for subjects, group in groups.items():
        common = frozenset.intersection(*map(frozenset, group.values()))
        if common and len(group) == len(subjects):  # otherwise some share theirs better in another group
            own = {subject: {each: by_template[each] for each in common} for subject, by_template in group.items()}
            shared[subjects] = own
    return shared


_Request = tuple[str, str, str, tuple[str, ...]]
"""Kind, permission, name and partitions of an elementary request."""
_Unit = tuple[Spot, str]
"""Place of an attachment, and a permission. The place, because the expanded text depends on the subject."""


def unused_rule_notes(policy: comarmor.Policy, graph: Graph) -> Iterator[Diagnostic]:
    """Yield notes on rules that no edge of a graph uses, and on subjects of the policy that the graph does not have."""
    units: dict[Spot, dict[_Unit, bool]] = {}
    needs: dict[str, set[_Request]] = {}
    for edge in graph.edges:
        needs.setdefault(edge.subject, set()).update(
            (kind, permission, edge.object.name + suffix, edge.object.partitions or ("",))
            for kind, permission, suffix in parts(edge.object.kind, edge.permission)
        )
    for subject in graph.subjects:
        for rule in (rule for profile in policy.applicable(subject) for rule in profile.rules):
            if rule.effect is comarmor.Effect.ALLOW:
                usage = units.setdefault(rule.where.spot, {})
                for unit, used in _used(rule, subject, needs.get(subject, ())):
                    usage[unit] = usage.get(unit, False) or used
    for place, usage in sorted(units.items()):
        yield from _unused_units(place, usage)
    for subject in policy.subjects():
        if subject not in graph.subjects:
            message = f"the policy names {subject}, which the graph does not have"
            yield Diagnostic.note("learn-unused-subject", message, subject=subject)


def _used(rule: comarmor.ProfileRule, subject: str, needs: Iterable[_Request]) -> Iterator[tuple[_Unit, bool]]:
    """Yield each attachment and permission of a rule, and whether the subject needs it."""
    for permission in rule.permissions:
        candidates = [
            (name.removesuffix(suffix), partitions)
            for kind, needed, name, partitions in needs
            for part_kind, part_permission, suffix in parts(rule.kind, permission)
            if (part_kind, part_permission) == (kind, needed) and name.endswith(suffix)
        ]
        for attachment in rule.attachments:
            expression = attachment.for_parts(*subject_parts(subject))
            used = any(
                matches(expression, name) and any(_in_partition(rule, partition) for partition in partitions)
                for name, partitions in candidates
            )
            yield (attachment.where.spot, permission), used


def _in_partition(rule: comarmor.ProfileRule, partition: str) -> bool:
    if rule.partitions:
        return any(matches(expression, partition) for expression in rule.partitions)
    return partition == ""


def _unused_units(place: Spot, usage: dict[_Unit, bool]) -> Iterator[Diagnostic]:
    """Yield notes on one rule that is not used, or on attachments and permissions of it that are not used."""
    if not any(usage.values()):
        permissions = ", ".join(dict.fromkeys(permission for _, permission in usage))
        yield _note("learn-unused-rule", place, f"no subject in the graph uses this rule ({permissions})")
        return
    for attachment in dict.fromkeys(unit[0] for unit in usage):
        if not any(used for unit, used in usage.items() if unit[0] == attachment):
            yield _note("learn-unused-attachment", attachment, "no subject in the graph uses this attachment")
    for permission in dict.fromkeys(unit[1] for unit in usage):
        if not any(used for unit, used in usage.items() if unit[1] == permission):
            yield _note("learn-unused-permission", place, f"no subject in the graph uses {permission} of this rule")


def _note(code: str, place: Spot, message: str) -> Diagnostic:
    file, line, column = place
    where = Origin(file, line, (), column)
    return Diagnostic.note(code, message, where, "remove it unless it is for a rare case")


def learn(graph: Graph, existing: LoadedPolicy | None, fragments: str) -> LearnedPolicy:
    """Return the rules that a graph needs in addition to an existing policy; see :class:`keymint.api.PolicyType`.

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
        # Only a DENY rule is a conflict; without one an ALLOW rule is missing.
        denied = next((part for part in decision.parts or (decision,) if not part.allowed and part.rule), None)
        if denied is None or denied.where is None:
            missing.append(edge)
            continue
        message = f"this rule denies {edge.subject} the {edge.permission} on {quote(requested.name)} that the graph has"
        help_ = "narrow the rule, or leave it: a DENY wins over every ALLOW"
        conflicts.append(Diagnostic.warning("learn-denied", message, denied.where.alone(), help_, edge.subject))
    subjects = [each for each in graph.subjects if policy is None or not policy.applicable(each)]
    granted = needs_of(missing)
    needs = {subject: granted.get(subject, set()) for subject in sorted({*subjects, *granted})}
    parts = share(needs) if fragments else ()
    return LearnedPolicy(
        document=document(needs, parts, fragments, _domain_note(graph)) if needs else b"",
        fragments={part.name: fragment(part.needs, part.name.removesuffix(".xml")) for part in parts},
        missing=tuple(missing),
        conflicts=tuple(dict.fromkeys(conflicts)),
        unused=tuple(unused_rule_notes(policy, graph)) if policy else (),
        notes=tuple(_generated(missing, needs)),
    )


def _generated(edges: Iterable[Edge], subjects: Iterable[str]) -> Iterator[Diagnostic]:
    """Yield a note for each expression that matches more than its name, and for each subject with a generated name."""
    told: set[str] = set()
    for edge in edges:
        expression, what = general_expression(edge.object.name, edge.object.kind)
        if what and expression not in told:
            told.add(expression)
            message = f"{expression} stands for {edge.object.name}: {what} changes with each start"
            yield Diagnostic.note("learn-generated", message, subject=edge.subject)
    for subject in filter(is_generated, subjects):
        message = f"the name of {subject} changes with each start, so its profile is about no enclave"
        help_ = "record it with its enclave, or name it: keymint discover --subject ID=NAME"
        yield Diagnostic.note("learn-generated", message, None, help_, subject)


def _domain_note(graph: Graph) -> str:
    """Return a comment on the DDS domains of a graph, which a policy cannot express; empty for the default domain."""
    domains = sorted({edge.domain for edge in graph.edges})
    if domains in ([], [0]):
        return ""
    return f"Learned in DDS domain {', '.join(map(str, domains))}; this document holds no domain: its workspace does."
