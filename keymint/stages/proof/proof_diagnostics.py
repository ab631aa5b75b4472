# SPDX-License-Identifier: Apache-2.0
"""Report claims that are refuted or unknown: one line per cause."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from comarmor.errors import Diagnostic
from keymint.api import Claim, Counterexample, Proof
from keymint.life import terms
from keymint.names import name_of
from keymint.stages.proof.proof_results import EnclaveProof, ProofEffort, ProofResults
from keymint.workspace.session import Session

STATES = 500_000


def merged_packages(diagnostics: Iterable[Diagnostic], shown: Callable[[str], str]) -> Iterator[Diagnostic]:
    """Yield diagnostics, merging those with the same cause in several packages.

    Args:
        diagnostics: the diagnostics of enclaves.
        shown: returns the directory of a package's documents as messages print it.
    """
    groups: dict[tuple[str, str, str], list[Diagnostic]] = {}
    for diagnostic in diagnostics:
        folder = shown(name_of(diagnostic.subject))
        text = diagnostic.message.removeprefix(diagnostic.subject).replace(f"{folder}/", "")
        place = str(diagnostic.where).removeprefix(f"{folder}/") if diagnostic.where else ""
        groups.setdefault((diagnostic.code, text, place), []).append(diagnostic)
    for group in groups.values():
        count = len({diagnostic.subject for diagnostic in group if diagnostic.subject})
        yield group[0] if count <= 1 else replace(group[0], message=f"{group[0].message} [{count} packages]")


def effort_of(
    monotonic: Callable[[], float], states: int = STATES, seconds: float = math.inf, *, standard_only: bool = False
) -> ProofEffort:
    """Return the limits of a proof: states per question, and seconds per enclave if the user asks for such a limit."""
    return ProofEffort(states, lambda: _deadline(monotonic, seconds), standard_only)


def _deadline(clock: Callable[[], float], seconds: float) -> Callable[[], bool]:
    end = clock() + seconds
    return lambda: clock() < end


def proof_findings(session: Session, results: ProofResults, *, strict: bool) -> tuple[Diagnostic, ...]:
    """Return what a proof found: open claims, what is not valid now, and earlier rights that are wider.

    Args:
        session: the workspace and its profile.
        results: the proof.
        strict: exceptions of claims are errors.
    """
    found = (*diagnostics_of(results, strict=strict), *dated_of(results))
    of_packages = merged_packages(found, lambda name: session.workspace.shown(session.enclave_folder(name)))
    return (*of_packages, *results.outliving)


def dated_of(results: ProofResults) -> Iterator[Diagnostic]:
    """Yield certificates and grants that are not valid at the time of the claims."""
    for enclave in results.enclaves:
        yield from terms.findings(enclave.terms, results.now, enclave.subject)


def diagnostics_of(results: ProofResults, *, strict: bool = False) -> list[Diagnostic]:
    """Return the diagnostics of all enclaves, each once.

    Args:
        results: their proofs.
        strict: exceptions of claims are errors.
    """
    return list(dict.fromkeys(each for enclave in results.all for each in _of_enclave(enclave, strict=strict)))


def _of_enclave(enclave: EnclaveProof, *, strict: bool) -> Iterator[Diagnostic]:
    """Yield the diagnostics of an enclave, merging the same result of several models."""
    yield from enclave.diagnostics
    who = enclave.subject or "all subjects"
    excepted = dict.fromkeys(exception for claim in enclave.claims for exception in claim.excepted) if strict else ()
    for exception in excepted:
        message = f"{who}: not part of the proof: {exception}"
        help_ = "change the policy or the sources, or accept it without --strict"
        yield Diagnostic.error("proof-exception", message, None, help_, enclave.subject)
    together: dict[tuple[object, ...], list[Claim]] = {}
    for claim in enclave.claims:
        if claim.counterexample is not None:
            found = claim.counterexample
            key = (found.endpoint, found.policy, found.document.allowed, found.document.where, found.document.reason)
            together.setdefault(key, []).append(claim)
        elif claim.proof is Proof.UNKNOWN:
            together.setdefault((claim.reason,), []).append(claim)
    for claims in together.values():
        models = ", ".join(dict.fromkeys(claim.model for claim in claims))
        counterexample = claims[0].counterexample
        if counterexample is None:
            actions = " and ".join(dict.fromkeys(claim.action for claim in claims))
            message = f"{who}, {actions}: not proven for {models}: {claims[0].reason}"
            help_ = f"write fewer wildcards; or search longer: 'keymint prove --states {10 * STATES}'"
            help_ = help_ if claims[0].spent else ""
            yield Diagnostic.error("not-proven", message, None, help_, enclave.subject)
        else:
            yield _refutation(enclave.subject, counterexample, models)


def _refutation(subject: str, counterexample: Counterexample, models: str) -> Diagnostic:
    endpoint, policy, document = counterexample.endpoint, counterexample.policy, counterexample.document
    who = subject or endpoint.subject or "all subjects"
    where = policy.where or counterexample.cause
    by_document = f"{document.where}: {document.reason}" if document.where else document.reason
    if counterexample.difference:
        message = f"{who}: {counterexample.difference}; {by_document} [{models}]"
        return Diagnostic.error("counterexample", message, where, counterexample.help, subject)
    may = "permits" if document.allowed else "does not permit"
    allows = "allows" if policy.allowed else "does not allow"
    name = f"{endpoint.name!r}" + "".join(f" in the partition {p!r}" for p in endpoint.partitions)
    meant = counterexample.meaning and counterexample.meaning.object
    ros = f" (the {meant.kind.replace('ros_', 'ROS ')} {meant.name})" if meant else ""
    domain = f" in domain {endpoint.domain}" if endpoint.domain else ""
    message = (
        f"{who}: the document {may} it to {endpoint.action} {name}{ros}{domain}, but the policy {allows} it: "
        f"{policy.reason}; {by_document} [{models}]"
    )
    deviation = f"; docs/vendors.md, {document.deviation}" if document.deviation else ""
    help_ = f"a shortest counterexample{deviation}{f'; {counterexample.help}' if counterexample.help else ''}"
    return Diagnostic.error("counterexample", message, where, help_, subject)
