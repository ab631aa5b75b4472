# SPDX-License-Identifier: Apache-2.0
"""What a proof may cost, and its results: for an enclave, for a package and its record, and for all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime

from comarmor.errors import Diagnostic
from comarmor.patterns import glob
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.values import dataclass
from keymint.api import Claim, ValidityTerm
from keymint.errors import KeymintError
from keymint.ir import Rule
from keymint.view.stamps import Stamp, State

STEPS = 30_000_000
"""Steps (:mod:`comarmor.patterns.steps`) that the proof of an enclave may take: a minute at most."""
_STEPS_PER_STATE = 60
_SHOWN = 3


@dataclass(frozen=True, slots=True)
class ProofEffort:
    """What is claimed, and the limits of the search.

    Attributes:
        states: states that one search may visit.
        deadline: called for each enclave; returns a function that tells whether to continue.
        standard_only: accept differences between vendors and claim only what the standard says; nothing is recorded.
    """

    states: int
    deadline: Callable[[], Callable[[], bool]]
    standard_only: bool = False

    @contextmanager
    def limit(self, rules: Iterable[Rule]) -> Iterator[None]:
        """Limit the steps of all questions about some rules; more states also allow more steps.

        Raises:
            KeymintError: the limit was reached between two questions.
        """
        try:
            with step_limit(max(STEPS, self.states * _STEPS_PER_STATE)):
                yield
        except StepLimitError as error:
            raise KeymintError(f"not proven: {error}{costliest(rules)}", code="not-proven") from None


def costliest(rules: Iterable[Rule]) -> str:
    """Return the places of the rules with the most wildcards, which make a proof costly, in words that follow a reason.

    Args:
        rules: the rules of the proof.
    """
    tokens = {rule: [token for each in rule.expressions for token in glob.parse(each)] for rule in rules}
    counts = {rule: sum(not isinstance(token, str) for token in each) for rule, each in tokens.items()}
    wild = sorted(filter(counts.__getitem__, counts), key=lambda rule: -counts[rule])
    places = ", ".join(dict.fromkeys(str(rule.origin.alone()) for rule in wild[:_SHOWN]))
    return f"; the rules with the most wildcards are at {places}" if places else ""


@dataclass(frozen=True, slots=True)
class EnclaveProof:
    """The result for one enclave, or across all packages of a build type, and what becomes of its record.

    Attributes:
        name: the package; of claims across subjects, their key in the record.
        subject: its subject; empty for claims across subjects.
        claims: by model, action and domains; none if the enclave could not be read.
        cached: every claim was proven before, and nothing changed.
        diagnostics: files that could not be read, or that do not rest on the workspace's authorities.
        terms: when the documents are in force.
        build_types: the build types of the package; of claims across subjects, the one that they are about.
        stamp: the record to keep; None if it does not change.
        refuted: the proof must not be on record.
    """

    name: str
    subject: str
    claims: tuple[Claim, ...] = ()
    cached: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()
    terms: tuple[ValidityTerm, ...] = ()
    build_types: tuple[str, ...] = ()
    stamp: Stamp | None = None
    refuted: bool = False


@dataclass(frozen=True, slots=True)
class ProofResults:
    """What is proven about a keystore.

    Attributes:
        enclaves: the result for each.
        shared: the results across subjects, for each build type that has some, and about all that may be presented.
        state: the record to keep.
        assumptions: assumptions of the claims, by model.
        standards: the models that are no vendor's: those that each prover names first.
        evidence: how each model is known, where its prover tells.
        now: the time at which the claims are judged, UTC.
        outliving: a note for each earlier document that permits more than the policy and was not accepted.
        is_whole: all documents that were ever signed are known.
    """

    enclaves: tuple[EnclaveProof, ...]
    shared: tuple[EnclaveProof, ...]
    state: State
    assumptions: Mapping[str, Sequence[str]]
    standards: frozenset[str]
    evidence: Mapping[str, str]
    now: datetime
    outliving: tuple[Diagnostic, ...] = ()
    is_whole: bool = True

    @property
    def all(self) -> tuple[EnclaveProof, ...]:
        """The results for all enclaves, and those across subjects."""
        return (*self.enclaves, *self.shared)
