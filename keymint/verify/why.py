# SPDX-License-Identifier: Apache-2.0
"""Explain one decision, from policy to transport."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.text import did_you_mean, nearest_word
from keymint.api import (
    ActionMapping,
    AppliedProfile,
    DomainRange,
    Enclave,
    Endpoint,
    LoadedPolicy,
    PolicyDecision,
    RuleLocator,
    Tier,
    Transport,
)
from keymint.errors import ExitCode, KeymintError
from keymint.graph import LABELLED, Edge, Object
from keymint.ir import Rule
from keymint.plan.enclaves import installed
from keymint.session import Session
from keymint.verify.compare import label_enclave
from keymint.verify.copies import copied
from keymint.verify.endpoint_policy import RAW, EndpointPolicy, Naming
from keymint.verify.explain import Explainer
from keymint.verify.matching import matching_rules, nearest
from keymint.verify.mismatch import Mismatch
from keymint.verify.scope import naming_of
from keymint.workspace import packages

_KIND_OF = {permission: kind for kind, permissions in LABELLED.items() for permission in permissions}


@dataclass(frozen=True, slots=True)
class MatchedRule:
    """A rule that applies to a request, its place, and a note if it only nearly applies."""

    rule: Rule
    where: Origin
    note: str = ""


@dataclass(frozen=True, slots=True)
class Need:
    """An endpoint that a transport must permit for a request, and the word for its name."""

    endpoint: Endpoint
    noun: str


@dataclass(frozen=True, slots=True)
class Explanation:
    """The decision of every layer on a request.

    Attributes:
        edge: the request.
        profiles: the profiles of the policy that apply to the subject.
        policy: the decision of the policy.
        rules: the rules of the policy that apply to the request, DENY first.
        near: if none applies, the rule that comes nearest, and the difference.
        similar: if the policy does not name the subject, a subject with a similar name.
        package: the rules of the source package that apply to the request.
        packaged: there is a source package.
        needs: what the transports must permit.
        installed: there is an enclave.
        labels: the decision of each transport, with the place in its document.
    """

    edge: Edge
    profiles: Sequence[AppliedProfile]
    policy: PolicyDecision
    rules: Sequence[MatchedRule]
    near: MatchedRule | None
    similar: str
    package: Sequence[MatchedRule]
    packaged: bool
    needs: Sequence[Need]
    installed: bool
    labels: Mapping[str, Mismatch]

    @property
    def wrong(self) -> Mapping[str, Mismatch]:
        """The labels that differ from the policy's decision."""
        return {name: each for name, each in self.labels.items() if each.verdict.allowed != self.policy.allowed}


def request(subject: str, permission: str, name: str, partitions: Sequence[str], domain: int) -> Edge:
    """Return the edge that a user asks for; the permission determines the kind of the object.

    Raises:
        KeymintError: the permission is unknown, or does not apply to such an object.
    """

    def refused(code: str, message: str, help_: str) -> KeymintError:
        return KeymintError(message, help=help_, code=code, exit_code=ExitCode.USAGE)

    if permission.endswith("relay"):
        message = f"{permission} is a permission of services that route data; no endpoint of a subject has it"
        raise refused("permission-unasked", message, "ask for publish or subscribe")
    if permission not in _KIND_OF:
        help_ = did_you_mean(permission, _KIND_OF, f"permissions are {', '.join(_KIND_OF)}")
        raise refused("permission-unknown", f"no permission {permission!r}", help_)
    kind = _KIND_OF[permission]
    if kind != RAW and not name.startswith("/"):
        message = f"a {kind} has no name {name!r}: ROS names begin with '/'"
        raise refused("object-name", message, f"did you mean {'/' + name!r}?")
    if kind != RAW and partitions:
        message = f"{permission} applies to a {kind}, and only a topic has partitions"
        raise refused("partition-unexpected", message, "leave out --partition, or ask for publish or subscribe")
    full = subject if subject.startswith("/") else f"/{subject}"
    return Edge(full, permission, Object(kind, name, tuple(sorted(set(partitions)))), domain)


def granted_domains(session: Session, subject: str) -> tuple[DomainRange, ...]:
    """Return the DDS domains of the grant of a subject; none if it has no source package.

    Raises:
        KeymintError: the source package has defects.
    """
    name = subject.removeprefix("/")
    if name not in packages(session.tree, session.workspace.src):
        return ()
    return session.package(name).grant.domains


def explain(
    session: Session,
    policy: LoadedPolicy,
    edge: Edge,
    transports: Mapping[str, Transport],
    find_models: Callable[[], Mapping[str, Transport]],
) -> Explanation:
    """Ask every layer of a workspace for one request.

    Args:
        session: the workspace and its profile.
        policy: its policy.
        edge: the request.
        transports: transports to ask, by name, each usable at the tier ``decision``.
        find_models: returns transports that name the rule that decides.

    Raises:
        KeymintError: the source package has defects, or a transport does not work.
    """
    name = edge.subject.removeprefix("/")
    package, naming, needs = _package(session, name, edge)
    endpoint_policy = EndpointPolicy(policy, {edge.subject: naming} if naming else {})
    decision = endpoint_policy.decide(edge)
    profiles = policy.profiles(edge.subject)
    subject_rules = policy.rules(edge.subject)
    rules = subject_rules.rules if subject_rules else ()
    matching = matching_rules(rules, _with_meanings(edge, naming))
    near = None if matching else nearest(rules, edge)
    subjects = policy.subjects()
    is_installed = name in installed(session)
    labels: dict[str, Mismatch] = {}
    if is_installed:
        install, folder = session.workspace.install, session.enclaves / name
        enclave = Enclave(edge.subject, folder, session.profile.distro, install)
        others = [session.enclaves / each for each in installed(session)]
        with copied(session.tree, install, {edge.subject: enclave}, transports.values(), others) as copies:
            readers = copies.read_by(transports)
            explainer = Explainer(endpoint_policy, readers, lambda: copies.read_by(find_models()))
            for each, transport in readers.items():
                verdicts = list(label_enclave(transport, enclave, [edge], Tier.DECISION))
                (labels[each],) = explainer(each, enclave, verdicts)
    return Explanation(
        edge=edge,
        profiles=profiles,
        policy=decision,
        rules=[MatchedRule(rules[at], rules[at].origin) for at in matching],
        near=MatchedRule(rules[near.at], rules[near.at].origin, near.lacks) if near else None,
        similar=nearest_word(edge.subject, subjects) if package is None and edge.subject not in subjects else "",
        package=package or (),
        packaged=package is not None,
        needs=needs,
        installed=is_installed,
        labels=labels,
    )


def _package(
    session: Session, name: str, edge: Edge
) -> tuple[Sequence[MatchedRule] | None, Naming | None, Sequence[Need]]:
    """Return the rules of a source package that apply to a request, and the naming of the package."""
    if name not in packages(session.tree, session.workspace.src):
        return None, None, ()
    files = session.package_files(name)
    package = session.package(name)
    rules = package.grant.rules.rules
    places = _places(session, name, files, rules)
    naming = naming_of(session, package)
    matching = matching_rules(rules, _with_meanings(edge, naming))
    needs: list[Need] = []
    for each_type in package.build_types:
        build_type = session.plugins.build_type(each_type, session.package_marker(name))
        if isinstance(build_type, ActionMapping):
            needs += (Need(each, build_type.NOUN) for each in build_type.actions(package.distro, edge))
    return [MatchedRule(rules[at], places[at]) for at in matching], naming, needs


def _with_meanings(edge: Edge, naming: Naming | None) -> Sequence[Edge]:
    """Return a request, followed by the ROS edges that a request on an endpoint stands for."""
    return (edge, *naming.meanings(edge)) if naming and edge.object.kind == RAW else (edge,)


def _places(session: Session, name: str, files: Mapping[str, bytes], rules: Sequence[Rule]) -> Sequence[Origin]:
    """Return the place of each rule in its package, or in the policy if the package type does not tell."""
    package_type = session.plugins.package_type(session.profile.package_type, session.profile_marker())
    if not isinstance(package_type, RuleLocator):
        return [rule.origin for rule in rules]
    folder = session.workspace.shown(session.workspace.src / name)
    return package_type.rule_places(name, folder, files)
