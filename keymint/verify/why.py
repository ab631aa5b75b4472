"""Explain one decision, from policy to transport."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.text import did_you_mean, nearest_word
from keymint.api import AppliedProfile, DomainRange, Enclave, LoadedPolicy, PolicyDecision, RuleLocator, Tier, Transport
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
class Explanation:
    """The decision of every layer on a request.

    Attributes:
        edge: the request.
        profiles: the profiles of the policy that apply to the subject.
        policy: what the policy says.
        rules: the rules of the policy that are about the request, deny first.
        near: where none is, the rule that comes nearest, with what it lacks.
        similar: where the policy does not name the subject, one with a similar name that it does.
        package: the rules of the source package that are about the request.
        packaged: there is a source package.
        endpoints: what the subject needs on the transport.
        installed: there is an enclave.
        labels: what each transport decides, with the place in the enclave's document.
    """

    edge: Edge
    profiles: Sequence[AppliedProfile]
    policy: PolicyDecision
    rules: Sequence[MatchedRule]
    near: MatchedRule | None
    similar: str
    package: Sequence[MatchedRule]
    packaged: bool
    endpoints: Sequence[Edge]
    installed: bool
    labels: Mapping[str, Mismatch]

    @property
    def wrong(self) -> Mapping[str, Mismatch]:
        """The labels that are not what the policy says."""
        return {name: each for name, each in self.labels.items() if each.verdict.allowed != self.policy.allowed}


def request(subject: str, permission: str, name: str, partitions: Sequence[str], domain: int) -> Edge:
    """Return the edge that a user asks for; the kind of the object is that of the permission.

    Raises:
        KeymintError: the permission is not known, or the object is none that it can be about.
    """
    if permission.endswith("relay"):
        raise KeymintError(
            f"{permission} is of services that route data, and no endpoint of a subject has it",
            help="ask for publishing or subscribing",
            code="permission-unasked",
            exit_code=ExitCode.USAGE,
        )
    if permission not in _KIND_OF:
        raise KeymintError(
            f"no permission {permission!r}",
            help=did_you_mean(permission, _KIND_OF, f"permissions are {', '.join(_KIND_OF)}"),
            code="permission-unknown",
            exit_code=ExitCode.USAGE,
        )
    kind = _KIND_OF[permission]
    if kind != RAW and not name.startswith("/"):
        raise KeymintError(
            f"a {kind} has no name {name!r}: ROS names begin with '/'",
            help=f"did you mean {'/' + name!r}?",
            code="object-name",
            exit_code=ExitCode.USAGE,
        )
    if kind != RAW and partitions:
        raise KeymintError(
            f"{permission} applies to a {kind}, and only a topic has partitions",
            help="leave --partition out, or ask for publish or subscribe",
            code="partition-unexpected",
            exit_code=ExitCode.USAGE,
        )
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
    return session.package(name).permissions.domains


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
    package, naming = _package(session, name, edge)
    endpoint_policy = EndpointPolicy(policy, {edge.subject: naming} if naming else {})
    decision = endpoint_policy.decide(edge)
    profiles = policy.profiles(edge.subject)
    subject_rules = policy.rules(edge.subject)
    rules = subject_rules.rules if subject_rules else ()
    edges = (edge, *naming.meanings(edge)) if naming and edge.object.kind == RAW else (edge,)
    matching = matching_rules(rules, edges)
    near = None if matching else nearest(rules, edge)
    subjects = policy.subjects()
    is_installed = name in installed(session)
    labels: dict[str, Mismatch] = {}
    if is_installed:
        enclave = Enclave(edge.subject, session.enclaves / name, session.profile.distro)
        with copied(session.tree, session.enclaves, {edge.subject: enclave}, transports) as copies:
            readers = copies.read_by(transports)
            explainer = Explainer(endpoint_policy, readers, lambda: copies.read_by(find_models()), session.tree)
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
        endpoints=naming.endpoints(edge) if naming else (),
        installed=is_installed,
        labels=labels,
    )


def _package(session: Session, name: str, edge: Edge) -> tuple[Sequence[MatchedRule] | None, Naming | None]:
    """Return the rules of a source package that are about a request, and how its names are mapped."""
    if name not in packages(session.tree, session.workspace.src):
        return None, None
    files = session.package_files(name)
    package = session.package(name)
    rules = package.permissions.rules.rules
    places = _places(session, name, files, rules)
    naming = naming_of(session, package)
    edges = (edge, *naming.meanings(edge)) if naming and edge.object.kind == RAW else (edge,)
    matching = matching_rules(rules, edges)
    return [MatchedRule(rules[at], places[at]) for at in matching], naming


def _places(session: Session, name: str, files: Mapping[str, bytes], rules: Sequence[Rule]) -> Sequence[Origin]:
    """Return where each rule of a package stands in the package, or in the policy where that is not told."""
    package_type = session.plugins.package_type(session.profile.package_type, session.profile_marker())
    if not isinstance(package_type, RuleLocator):
        return [rule.origin for rule in rules]
    folder = session.workspace.shown(session.workspace.src / name)
    return package_type.rule_places(name, folder, files)
