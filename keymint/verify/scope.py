# SPDX-License-Identifier: Apache-2.0
"""The scope of a verification: installed enclaves of one build type, their naming, and the edges to test."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TypeVar

from comarmor.text import did_you_mean, first_few
from comarmor.values import Data, replace
from keymint.api import BuildType, InstalledEnclave, LoadedPolicy, Package, Role, Transport
from keymint.api.graph import LABELLED, Column, Edge, Graph, Object, column
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint.names import subject_of
from keymint.stages.identities import missing_enclave
from keymint.verify import probes
from keymint.verify.endpoint_policy import RAW, EdgeRow, EdgeRows, Naming
from keymint.workspace.installed_enclaves import enclave_names
from keymint.workspace.session import Inputs, Session

_Value = TypeVar("_Value")


@lru_cache(maxsize=1 << 16)
def has_name(build_type: BuildType, distro: str, object_: Object) -> bool:
    """Tell whether an object has a name on the transports of a build type.

    Args:
        build_type: the build type.
        distro: ROS 2 distribution whose name mapping applies.
        object_: the object.

    Raises:
        KeymintError: the distribution has no objects of this kind.
    """
    if object_.kind not in build_type.KINDS:
        return False
    actions = build_type.actions(distro, Edge("/", LABELLED[object_.kind][0], object_))
    return bool(actions) or not build_type.NOUN


class VerificationScope(Data):
    """The scope of a verification for one build type.

    Attributes:
        build_type: its name.
        plugin: the build type.
        distro: ROS 2 distribution whose name mapping applies.
        enclaves: installed enclaves by subject, sorted.
        namings: the naming of each subject, if the build type has one.
        domains: the first domain of each subject's grant.
        select: returns the edges to ask about in place of an edge [the edge].
    """

    build_type: str
    plugin: BuildType
    distro: str
    enclaves: Mapping[str, InstalledEnclave]
    namings: Mapping[str, Naming]
    domains: Mapping[str, int]
    select: Callable[[InstalledEnclave, Edge], Sequence[Edge]] | None = None

    def has_name(self, object_: Object) -> bool:
        """Tell whether an object has a name on the transports; these are not asked about others."""
        return has_name(self.plugin, self.distro, object_)

    def about(self, subjects: Iterable[str]) -> VerificationScope:
        """Return the scope of some of the subjects."""

        def those(by_subject: Mapping[str, _Value]) -> dict[str, _Value]:
            return {subject: by_subject[subject] for subject in subjects if subject in by_subject}

        return replace(self, enclaves=those(self.enclaves), namings=those(self.namings), domains=those(self.domains))


def installed_scopes(
    session: Session, names: Sequence[str]
) -> tuple[Mapping[str, VerificationScope], Mapping[str, InstalledEnclave], frozenset[Path], frozenset[Path]]:
    """Return the scopes of a verification of some packages; those of the infrastructure have no rights to verify.

    Returns:
        The scope of each build type of the packages, by its name; all enclaves by subject, sorted; the folders of the
        other installed enclaves; and those of them that belong to the infrastructure of the transports.

    Raises:
        KeymintError: there are no packages, or one is not installed or has defects.
    """
    loaded = {name: session.package(name) for name in sorted(names)}
    chosen = {name: package for name, package in loaded.items() if package.role is Role.SUBJECT}
    if loaded and not chosen:
        message = f"{' and '.join(loaded)} has no rights to verify: it belongs to the infrastructure of a transport"
        raise KeymintError(message, help="name a package of a subject", code="packages-none")
    if not chosen:
        raise KeymintError("there is no package to verify", help="run 'keymint create --all'", code="packages-none")
    there = set(enclave_names(session))
    if missing := [name for name in chosen if name not in there]:
        message = f"no enclave of {first_few([*map(subject_of, missing)])} is installed"
        help_ = missing_enclave(session, chosen[missing[0]]).help
        raise KeymintError(message, help=help_, code="enclave-missing")
    packages = {package.subject: package for package in chosen.values()}
    install = session.workspace.install
    enclaves = {
        subject: InstalledEnclave(subject, session.enclave(package.name), package.distro, install)
        for subject, package in sorted(packages.items())
    }
    infrastructure = {each.name for package in chosen.values() for each in package.infrastructure}
    build_types = dict.fromkeys(name for package in chosen.values() for name in package.build_types)
    return (
        {name: _scope(session, name, packages, enclaves) for name in build_types},
        enclaves,
        frozenset(session.enclave(name) for name in there.difference(chosen)),
        frozenset(session.enclave(name) for name in there.intersection(infrastructure)),
    )


def _scope(
    session: Session, name: str, packages: Mapping[str, Package], enclaves: Mapping[str, InstalledEnclave]
) -> VerificationScope:
    """Return the scope of a build type."""
    built = {subject: packages[subject] for subject in sorted(packages) if name in packages[subject].build_types}
    namings = {subject: naming_of(session, package, name) for subject, package in built.items()}
    where = session.package_marker(next(iter(built.values())).name)
    return VerificationScope(
        name,
        session.plugins.build_type(name, where),
        session.profile.distro,
        {subject: enclaves[subject] for subject in built},
        {subject: naming for subject, naming in namings.items() if naming},
        {subject: package.grant.domains[0].first for subject, package in built.items() if package.grant.domains},
    )


def naming_of(inputs: Inputs, package: Package, build_type: str) -> Naming | None:
    """Return the naming of a package for one of its build types, or None if that has none."""
    mapping = inputs.plugins.build_type(build_type, inputs.package_marker(package.name)).names
    return Naming(mapping, package.distro) if mapping else None


def selective(scope: VerificationScope, transports: Iterable[Transport]) -> VerificationScope:
    """Return a scope with the edges that transports can be asked about; one of them at most selects."""
    select = next((each.asked for each in transports if each.SELECTIVE), None)
    return replace(scope, select=select)


def selected_rows(rows: EdgeRows, scope: VerificationScope) -> EdgeRows:
    """Return a function that yields rows with the edges that the transports of a scope can be asked about."""
    select = scope.select
    if select is None:
        return rows

    def row_of(row: EdgeRow) -> EdgeRow:
        found = (each for edge in row for each in select(scope.enclaves[row.subject], edge))
        return EdgeRow(row.subject, Column(tuple(dict.fromkeys(found))))

    return lambda: map(row_of, rows())


def subjects_of_graph(graph: Graph, known: Collection[str], *, only: bool) -> Graph:
    """Return a graph without the subjects that have no enclave here.

    Args:
        graph: the graph.
        known: the subjects with an enclave.
        only: ignore other subjects.

    Raises:
        KeymintError: a subject of the graph has no enclave here, or the graph is empty.
    """
    missing = [subject for subject in graph.subjects if subject not in known]
    if not graph.edges:
        raise KeymintError("the graph has no edges: nothing to verify", code="graph-empty")
    if missing and not only:
        raise KeymintError(
            f"the graph has a subject {missing[0]}, but no such enclave is verified",
            help=did_you_mean(missing[0], known, f"'keymint create {missing[0]}', build and install it"),
            code="enclave-missing",
        )
    return replace(graph, subjects=tuple(subject for subject in graph.subjects if subject in known))


def edges_of_graph(graph: Graph, scope: VerificationScope) -> tuple[tuple[str, ...], EdgeRows]:
    """Return the subjects of a graph in a scope, and a function that yields all possible edges of them."""
    kept = tuple(subject for subject in graph.subjects if subject in scope.enclaves)
    requests = column(replace(graph, edges=tuple(edge for edge in graph.edges if scope.has_name(edge.object))))
    return kept, lambda: (EdgeRow(subject, requests) for subject in kept)


def common_objects(policy: LoadedPolicy, scope: VerificationScope) -> tuple[Object, ...]:
    """Return the objects of the policy that every subject of a scope is asked about."""
    enclave = next(iter(scope.enclaves.values()), None)
    installed_names = scope.plugin.installed_names(enclave) if enclave else ()
    return probes.common_objects(_rules(policy, scope), installed_names)


def _rules(policy: LoadedPolicy, scope: VerificationScope) -> list[SubjectRules]:
    return [policy.rules(subject) or SubjectRules(subject, ()) for subject in scope.enclaves]


def made_up_objects(policy: LoadedPolicy, scope: VerificationScope, edges: Iterable[Edge]) -> Iterator[Object]:
    """Yield the objects of edges that neither a rule nor a part of what it names has as its name: they probe patterns.

    A raw topic is named if a ROS object that it carries is.
    """
    named = {object_ for each in _rules(policy, scope) for object_ in probes.named_objects(each)}
    for edge in {edge.object: edge for edge in edges}.values():
        naming = scope.namings.get(edge.subject) if edge.object.kind == RAW else None
        meanings = (each.object for each in naming.meanings(edge)) if naming else ()
        if edge.object not in named and named.isdisjoint(meanings):
            yield edge.object


def edges_of_policy(policy: LoadedPolicy, scope: VerificationScope, common: Sequence[Object]) -> EdgeRows:
    """Return a function that yields edges on the objects of the policy and the documents, and on probing names.

    Args:
        policy: the policy.
        scope: the enclaves.
        common: the objects that every subject is asked about.
    """
    rules = _rules(policy, scope)

    @cache  # each transport asks for the edges, and reading a document is slow
    def topics(subject: str) -> Sequence[tuple[str, Sequence[str]]]:
        """Return the topics that the subject's own documents mention, with their partitions."""
        naming = scope.namings.get(subject)
        return naming.mapping.document_topics(scope.enclaves[subject]) if naming else ()

    def mentioned(subject: str) -> Iterator[Edge]:
        for name, partitions in topics(subject):
            yield from probes.raw_edges(subject, name, partitions, scope.domains.get(subject, 0))

    def needed(edge: Edge) -> Sequence[Edge]:
        """Return the endpoints of an edge, if they are known."""
        naming = scope.namings.get(edge.subject)
        return naming.endpoints(edge) if naming else ()

    def rows() -> Iterator[EdgeRow]:
        edges = probes.edges(rules, common, scope.domains, scope.has_name, mentioned, needed)
        for subject, group in groupby(edges, key=attrgetter("subject")):
            yield EdgeRow(subject, Column(tuple(group)))

    return rows
