# SPDX-License-Identifier: Apache-2.0
"""What a proof may cost, and its results: for an enclave, for a package and its record, and for all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.api import Claim, ValidityTerm
from keymint.state import Stamp, State


@dataclass(frozen=True, slots=True)
class ProofEffort:
    """The limits of the search.

    Attributes:
        states: states that one search may visit.
        deadline: called for each enclave; returns a function that tells whether to continue.
    """

    states: int
    deadline: Callable[[], Callable[[], bool]]


@dataclass(frozen=True, slots=True)
class EnclaveProof:
    """The result for one enclave.

    Attributes:
        subject: its subject.
        claims: by model, action and domains; none if the enclave could not be read.
        cached: every claim was proven before, and nothing changed.
        diagnostics: files that could not be read, or that do not rest on the workspace's authorities.
        terms: when the documents are in force.
        build_type: of claims across subjects, the build type; the subject is empty.
    """

    subject: str
    claims: tuple[Claim, ...] = ()
    cached: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()
    terms: tuple[ValidityTerm, ...] = ()
    build_type: str = ""


@dataclass(frozen=True, slots=True)
class PackageProof:
    """The proof of one package, or across all packages of a build type, and what becomes of its record.

    Attributes:
        name: the package; of claims across subjects, their key in the record.
        proof: the result.
        build_types: the build types of the package.
        stamp: the record to keep; None if it does not change.
        refuted: the proof must not be on record.
    """

    name: str
    proof: EnclaveProof
    build_types: tuple[str, ...] = ()
    stamp: Stamp | None = None
    refuted: bool = False


@dataclass(frozen=True, slots=True)
class ProofResults:
    """The results for all enclaves.

    Attributes:
        enclaves: the result for each.
        shared: the results across subjects, for each build type that has some.
        state: the record to keep.
        assumptions: assumptions of the claims, by model.
        standards: the models that are no vendor's: those that each prover names first.
        now: the time at which the claims are judged, UTC.
    """

    enclaves: tuple[EnclaveProof, ...]
    shared: tuple[EnclaveProof, ...]
    state: State
    assumptions: Mapping[str, Sequence[str]]
    standards: frozenset[str]
    now: datetime

    @property
    def all(self) -> tuple[EnclaveProof, ...]:
        """The results for all enclaves, and those across subjects."""
        return (*self.enclaves, *self.shared)
