# SPDX-License-Identifier: Apache-2.0
"""Explain one decision, from policy to transport: the rules that apply, or the one that nearly does, and the labels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache, partial

from comarmor.patterns import glob
from comarmor.patterns.expression import matches, rule_matches, rule_matches_partition
from comarmor.rules import Effect, parts
from comarmor.text import nearest_word
from comarmor.values import Data
from keymint import api
from keymint.api.graph import Edge, Object
from keymint.errors import KeymintError, Origin, usage_error
from keymint.ir import Rule
from keymint.names import name_of, typed_permission, typed_subject
from keymint.verify.compare import Mismatch, label_enclave
from keymint.verify.copies import enclave_copies
from keymint.verify.endpoint_policy import RAW, EndpointPolicy
from keymint.verify.scope import has_name, naming_of
from keymint.verify.transports import Explainer, models
from keymint.workspace.installed_enclaves import enclave_names
from keymint.workspace.session import Session
from keymint.workspace.workspace import packages


class Explanation(Data):
    """The decision of every layer on a request.

    Attributes:
        edge: the request.
        profiles: the profiles of the policy that apply to the subject.
        policy: the decision of the policy, as the first build type applies it.
        rules: the rules of the policy that apply to the request, DENY first.
        near: if none applies, the rule that comes nearest, and the difference.
        similar: if the policy does not name the subject, a subject with a similar name.
        package: the rules of the source package that apply to the request.
        packaged: there is a source package.
        needs: the endpoints that the transports must permit, each with the word for its name.
        decisions: the decision of the policy as each build type applies it, by its name; those that have no name for
            the object are missing.
        installed: there is an enclave.
        labels: the decision of each transport, with the place in its document.
        unasked: transports without a name for the object, by build type.
    """

    edge: Edge
    profiles: Sequence[api.AppliedProfile]
    policy: api.PolicyDecision
    decisions: Mapping[str, api.PolicyDecision]
    rules: Sequence[MatchedRule]
    near: MatchedRule | None
    similar: str
    package: Sequence[MatchedRule]
    packaged: bool
    needs: Sequence[tuple[api.Endpoint, str]]
    installed: bool
    labels: Mapping[str, Mismatch]
    unasked: Mapping[str, Sequence[str]]

    @property
    def wrong(self) -> Mapping[str, Mismatch]:
        """The labels that differ from the policy's decision."""
        return {
            name: each
            for name, each in self.labels.items()
            if each.verdict.partial or each.verdict.allowed != each.policy.allowed
        }


def request(subject: str, permission: str, name: str, kind: str, partitions: Sequence[str], domain: int) -> Edge:
    """Return the edge that a user asks for, in the words of :func:`keymint.names.typed_permission`.

    Raises:
        KeymintError: the permission is unknown, or does not apply to such an object.
    """
    if permission.endswith("relay"):
        message = f"{permission} is a permission of services that route data; no endpoint of a subject has it"
        raise usage_error(message, "ask for publish or subscribe", "permission-unasked")
    kind, permission = typed_permission(permission, name, kind, ("/",))
    if kind != RAW and partitions:
        message = f"{permission} applies to a {kind}, and only a topic has partitions"
        raise usage_error(message, "leave out --partition, or ask for publish or subscribe", "partition-unexpected")
    return Edge(typed_subject(subject), permission, Object(kind, name, tuple(sorted(set(partitions)))), domain)


def source_package(session: Session, subject: str) -> api.Package | None:
    """Return the source package of a subject; None if it has none.

    Raises:
        KeymintError: it has defects, or belongs to the infrastructure of a transport.
    """
    name = name_of(subject)
    if name not in packages(session.tree, session.workspace.src):
        return None
    package = session.package(name)
    if package.role is api.Role.INFRASTRUCTURE:
        message = f"{subject} has no rights to explain: it belongs to the infrastructure of a transport"
        raise KeymintError(message, help="name a subject of the policy", code="packages-none")
    return package


_Transports = Mapping[str, Mapping[str, api.Transport]]
"""Transports by build type and name."""


def explain(
    session: Session, policy: api.LoadedPolicy, package: api.Package | None, edge: Edge, transports: _Transports
) -> Explanation:
    """Ask every layer of a workspace for one request.

    Args:
        session: the workspace and its profile.
        policy: its policy.
        package: the source package of the subject, if it has one.
        edge: the request.
        transports: transports to ask, each usable at the tier ``decision``.

    Raises:
        KeymintError: a transport does not work.
    """
    views = _views(session, policy, package, edge)
    meanings = tuple(dict.fromkeys(each for view in views.values() for each in view.meanings))
    decisions = {name: view.policy.decide(edge) for name, view in views.items()}
    subject_rules = policy.rules(edge.subject)
    rules = subject_rules.rules if subject_rules else ()
    matching = matching_rules(rules, (edge, *meanings))
    subjects = policy.subjects()
    is_installed = name_of(edge.subject) in enclave_names(session)
    asked = {name: group for name, group in transports.items() if name in views}
    return Explanation(
        edge=edge,
        profiles=policy.profiles(edge.subject),
        policy=next(iter(decisions.values()), policy.decide(edge)),
        decisions=decisions,
        rules=[MatchedRule(rules[at], rules[at].origin) for at in matching],
        near=None if matching else nearest(rules, edge),
        similar=nearest_word(edge.subject, subjects) if package is None and edge.subject not in subjects else "",
        package=_rules_of_package(session, package, (edge, *meanings)) if package else (),
        packaged=package is not None,
        needs=[need for view in views.values() for need in view.needs],
        installed=is_installed,
        labels=_labels(session, package, edge, views, asked) if is_installed else {},
        unasked={name: tuple(group) for name, group in transports.items() if name not in views},
    )


class _View(Data):
    """A request as a build type sees it.

    Attributes:
        policy: the policy on endpoints.
        meanings: the ROS edges that a request on an endpoint stands for.
        needs: the endpoints that the transports must permit, each with the word for its name; none without a package.
    """

    policy: EndpointPolicy
    meanings: Sequence[Edge]
    needs: Sequence[tuple[api.Endpoint, str]]


def _views(session: Session, policy: api.LoadedPolicy, package: api.Package | None, edge: Edge) -> Mapping[str, _View]:
    """Return the views of the build types that have a name for the object of a request."""
    views: dict[str, _View] = {}
    for name in package.build_types if package else session.profile.build_types:
        where = session.package_marker(package.name) if package else session.profile_marker()
        build_type = session.plugins.build_type(name, where)
        if not has_name(build_type, session.profile.distro, edge.object):
            continue
        naming = naming_of(session, package, name) if package else None
        endpoint_policy = EndpointPolicy(policy, {edge.subject: naming} if naming else {})
        meanings = naming.meanings(edge) if naming and edge.object.kind == RAW else ()
        needed = build_type.actions(package.distro, edge) if package and package.distro else ()
        views[name] = _View(endpoint_policy, meanings, [(each, build_type.NOUN) for each in needed])
    return views


def _labels(
    session: Session, package: api.Package | None, edge: Edge, views: Mapping[str, _View], asked: _Transports
) -> Mapping[str, Mismatch]:
    """Return the decisions of transports on copies of the enclave."""
    install, name = session.workspace.install, name_of(edge.subject)
    enclave = api.InstalledEnclave(edge.subject, session.enclave(name), session.profile.distro, install)
    folders = {each: session.enclave(each) for each in enclave_names(session)}
    needed = {each.name for each in package.infrastructure} if package else set[str]()
    infrastructure = [folder for each, folder in folders.items() if each in needed]
    transports = [each for group in asked.values() for each in group.values()]
    enclaves = {edge.subject: enclave}
    labels: dict[str, Mismatch] = {}
    with enclave_copies(session.tree, install, enclaves, transports, folders.values(), infrastructure) as copies:
        (copy,) = copies.enclaves.values()
        for build_type, group in asked.items():
            find_models = cache(partial(models, session.plugins, build_type, distro=session.profile.distro))
            explainer = Explainer(views[build_type].policy, group, find_models, copies)
            for each, transport in group.items():
                verdicts = list(label_enclave(transport, copy, [edge], api.Tier.DECISION))
                (labels[each],) = explainer(each, copy, verdicts)
    return labels


def _rules_of_package(session: Session, package: api.Package, edges: Sequence[Edge]) -> Sequence[MatchedRule]:
    """Return the rules of a source package that apply to a request."""
    rules, folder = package.grant.rules.rules, session.workspace.shown(session.workspace.src / package.name)
    places = session.package_type.rule_places(package.name, folder, session.package_files(package.name))
    if places is None:  # only the policy's own places are known
        places = [rule.origin for rule in rules]
    return [MatchedRule(rules[at], places[at]) for at in matching_rules(rules, edges)]


def matching_rules(rules: Sequence[Rule], edges: Iterable[Edge]) -> list[int]:
    """Return the positions of the rules that apply to any of some edges or to a part of it, DENY rules first."""
    positions = {at for edge in edges for at, rule in enumerate(rules) if _applies(rule, edge)}
    return sorted(positions, key=lambda at: (rules[at].effect is Effect.ALLOW, at))


def _applies(rule: Rule, edge: Edge) -> bool:
    return any(
        rule_matches(rule, kind, permission, edge.object.name + suffix)
        for kind, permission, suffix in parts(edge.object.kind, edge.permission)
    ) and any(rule_matches_partition(rule, partition) for partition in edge.object.partitions or ("",))


class MatchedRule(Data):
    """A rule that applies to a request, its place, and a note if it only nearly applies."""

    rule: Rule
    where: Origin
    note: str = ""


def nearest(rules: Sequence[Rule], edge: Edge) -> MatchedRule | None:
    """Return the ALLOW rule that comes nearest to an edge, with the difference in words, or None.

    The same object with another permission is nearer than an object with a similar name.
    """
    kind, permission = edge.object.kind, edge.permission
    allows = [rule for rule in rules if rule.effect is Effect.ALLOW]
    lacks = [(rule, _lack(rule, edge)) for rule in allows]
    found = [(rule, *lack) for rule, lack in lacks if lack]
    if found:
        rule, _, text = min(found, key=lambda each: each[1])
        return MatchedRule(rule, rule.origin, text)
    fitting = [rule for rule in reversed(allows) if rule.kind == kind and permission in rule.permissions]
    by_expression = {each: rule for rule in fitting for each in rule.expressions}
    if not (near := nearest_word(edge.object.name, by_expression)):
        return None
    return MatchedRule(by_expression[near], by_expression[near].origin, f"it applies to {near!r}; did you mean that?")


def _lack(rule: Rule, edge: Edge) -> tuple[int, str] | None:
    """Return what an ALLOW rule lacks to permit an edge on its object, in words, after a rank: the nearest first.

    None: it is about another object.
    """
    kind, permission = edge.object.kind, edge.permission
    named = any(matches(each, edge.object.name) for each in rule.expressions)
    if named and kind == rule.kind == RAW and permission in rule.permissions:
        partitions = f"partitions {', '.join(map(repr, rule.partitions))}"
        return 0, f"it applies to {partitions if rule.partitions else 'the default partition only'}"
    if named and kind == rule.kind and permission not in rule.permissions:
        return 1, f"it allows {', '.join(rule.permissions)}, not {permission}"
    if kind != rule.kind and any(glob.literal(glob.parse(each)) == edge.object.name for each in rule.expressions):
        return 2, f"it is a {rule.kind} rule, and {permission} is a permission of {kind}"
    return None
