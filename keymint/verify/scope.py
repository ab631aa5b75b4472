# SPDX-License-Identifier: Apache-2.0
"""The scope of a verification: installed enclaves, their naming, and the edges to test."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

from comarmor.text import did_you_mean
from keymint.api import Enclave, LoadedPolicy, NameMapping, Package
from keymint.errors import KeymintError
from keymint.graph import Edge, Graph, complete
from keymint.ir import SubjectRules
from keymint.plan.enclaves import installed
from keymint.session import Inputs, Session
from keymint.verify import probes
from keymint.verify.endpoint_policy import Naming


@dataclass(frozen=True, slots=True)
class VerificationScope:
    """The scope of a verification.

    Attributes:
        enclaves: installed enclaves by subject, sorted.
        namings: the naming of each subject whose build type has one.
        domains: the first DDS domain of each subject's grant.
    """

    enclaves: Mapping[str, Enclave]
    namings: Mapping[str, Naming]
    domains: Mapping[str, int]


def verification_scope(session: Session, names: Sequence[str]) -> VerificationScope:
    """Return the scope of a verification of some packages.

    Raises:
        KeymintError: there are no packages, or one is not installed or has defects.
    """
    if not names:
        raise KeymintError("there is no package to verify", help="run 'keymint create --all'", code="packages-none")
    there = set(installed(session))
    missing = [name for name in names if name not in there]
    if missing:
        shown = ", ".join(f"/{name}" for name in missing[:5]) + (" …" if len(missing) > 5 else "")  # noqa: PLR2004
        raise KeymintError(
            f"no enclave of {shown} is installed",
            help="run 'keymint build' and 'keymint install'",
            code="enclave-missing",
        )
    enclaves: dict[str, Enclave] = {}
    namings: dict[str, Naming] = {}
    domains: dict[str, int] = {}
    for name in sorted(names):
        package = session.package(name)
        enclaves[package.subject] = Enclave(
            package.subject, session.enclaves / name, package.distro, session.workspace.install
        )
        naming = naming_of(session, package)
        if naming:
            namings[package.subject] = naming
        if package.grant.domains:
            domains[package.subject] = package.grant.domains[0].first
    return VerificationScope(dict(sorted(enclaves.items())), namings, domains)


def naming_of(inputs: Inputs, package: Package) -> Naming | None:
    """Return the naming of a package, or None if its build type offers none."""
    build_type = inputs.plugins.build_type(package.build_types[0], inputs.package_marker(package.name))
    return Naming(build_type, package.distro) if isinstance(build_type, NameMapping) else None


def edges_of_graph(
    graph: Graph, scope: VerificationScope, *, only: bool
) -> tuple[tuple[str, ...], Callable[[], Iterator[Edge]]]:
    """Return the subjects of a graph to verify, and a function that yields all possible edges of them.

    Args:
        graph: the graph.
        scope: the scope.
        only: ignore subjects outside of the scope.

    Raises:
        KeymintError: a subject of the graph has no enclave here, or the graph is empty.
    """
    missing = [subject for subject in graph.subjects if subject not in scope.enclaves]
    if not graph.edges:
        raise KeymintError("the graph has no edges: nothing to verify", code="graph-empty")
    if missing and not only:
        raise KeymintError(
            f"the graph has a subject {missing[0]}, but no such enclave is verified",
            help=did_you_mean(missing[0], scope.enclaves, f"'keymint create {missing[0]}', build and install it"),
            code="enclave-missing",
        )
    kept = tuple(subject for subject in graph.subjects if subject in scope.enclaves)
    return kept, lambda: complete(replace(graph, subjects=kept))


def edges_of_policy(policy: LoadedPolicy, scope: VerificationScope) -> Callable[[], Iterator[Edge]]:
    """Return a function that yields edges on the objects of the policy and the documents, and on probing names."""
    rules = [policy.rules(subject) or SubjectRules(subject, ()) for subject in scope.enclaves]

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

    return lambda: probes.edges(rules, scope.domains, mentioned, needed)
