# SPDX-License-Identifier: Apache-2.0
"""What a proof may cost, and its results: their record, and the report of claims that are refuted or unknown.

The record has the claims about an enclave that were all proven, as the outputs of a stamp; the report has one line per
cause.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from functools import lru_cache

from comarmor.patterns import glob
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.values import Data, replace
from keymint.api import Claim, Counterexample, DomainRange, Proof, ValidityTerm
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.ir import Kind, Rule, SubjectRules, once_of_kind
from keymint.life import terms
from keymint.names import name_of
from keymint.view.stamps import Stamp, StampRow, State, digest, digest_of_texts
from keymint.workspace.session import Session

STEPS = 30_000_000
"""Steps (:mod:`comarmor.patterns.steps`) that the proof of an enclave may take: a minute at most."""
STATES = 500_000
_STEPS_PER_STATE = 60
_SHOWN = 3


class ProofEffort(Data):
    """What is claimed, and the limits of the search.

    Attributes:
        monotonic: returns seconds.
        states: states that one search may visit.
        seconds: the most seconds for each enclave.
        standard_only: accept differences between vendors and claim only what the standard says; nothing is recorded.
    """

    monotonic: Callable[[], float]
    states: int = STATES
    seconds: float = math.inf
    standard_only: bool = False

    def deadline(self) -> Callable[[], bool]:
        """Return a function that tells whether to continue with the enclave that is about to be proven."""
        end = self.monotonic() + self.seconds
        return lambda: self.monotonic() < end

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


class EnclaveProof(Data):
    """The result for one enclave, or across all packages of a build type, and what becomes of its record.

    Attributes:
        name: the package; of claims across subjects, their key in the record.
        subject: its subject; empty for claims across subjects.
        claims: by model, action and domains; none if the enclave could not be read.
        cached: every claim was proven before, and nothing changed.
        diagnostics: files that could not be read, or that do not rest on the workspace's authorities.
        terms: when the documents are in force.
        build_types: the build types of the package; of claims across subjects, the one that they are about.
        stamp: the record to keep, perhaps as it is written; None if it does not change.
        refuted: the proof must not be on record.
    """

    name: str
    subject: str
    claims: tuple[Claim, ...] = ()
    cached: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()
    terms: tuple[ValidityTerm, ...] = ()
    build_types: tuple[str, ...] = ()
    stamp: Stamp | StampRow | None = None
    refuted: bool = False


class ProofResults(Data):
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
    may, _, allows = in_words(counterexample)
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


def in_words(example: Counterexample) -> tuple[str, str, str]:
    """Return in words whether the document permits what an example names, what that is, and what the policy says."""
    permits = "permits" if example.document.allowed else "does not permit"
    allows = "allows" if example.policy.allowed else "does not allow"
    meaning = f" ({example.meaning.permission} {example.meaning.object.name})" if example.meaning else ""
    return permits, f"{example.endpoint.action} {example.endpoint.name!r}{meaning}", allows


RULES, _CLAIMS, TERMS, WRITTEN = "rules", "claims", "terms", "written"
"""Keys of the outputs."""


def dump_proof(
    claims: Sequence[Claim], terms: Sequence[ValidityTerm], rules: Iterable[SubjectRules], folder: str
) -> Mapping[str, str]:
    """Return the outputs of a stamp.

    Args:
        claims: the proven claims.
        terms: when the documents are in force.
        rules: the rules of the policy that the claims are about.
        folder: the folder of the documents, as messages show it; recorded places are relative to it.
    """
    rows = [
        _row(
            each.code, each.what, each.where.file.removeprefix(f"{folder}/"), each.where.line, each.periods, each.models
        )
        for each in terms
    ]
    return {_CLAIMS: dump_claims(tuple(claims)), RULES: placeless_digest(rules), TERMS: f"[{','.join(rows)}]"}


# The authorities of all enclaves are the same.
@lru_cache(maxsize=64)
def _row(
    code: str, what: str, file: str, line: int, periods: tuple[tuple[datetime, datetime], ...], models: tuple[str, ...]
) -> str:
    """Return when a document is in force, as text."""
    return _json((code, what, file, line, [(_date(first), _date(last)) for first, last in periods], models))


_json = json.JSONEncoder(separators=(",", ":")).encode
_date = lru_cache(maxsize=64)(datetime.isoformat)
_moment = lru_cache(maxsize=64)(datetime.fromisoformat)


# The claims about most enclaves are the same.
@lru_cache(maxsize=64)
def dump_claims(claims: tuple[Claim, ...]) -> str:
    """Return proven claims as text."""
    return _json(
        [
            (each.model, each.action, [(of.first, of.last) for of in each.domains], each.universe, each.excepted)
            for each in claims
        ]
    )


def load_proof(stamp: Stamp, folder: str) -> tuple[tuple[Claim, ...], tuple[ValidityTerm, ...]] | None:
    """Return the recorded claims and terms, or None if the stamp has no legible ones."""
    try:
        terms = tuple(
            ValidityTerm(
                str(code),
                str(what),
                Origin(f"{folder}/{file}", int(line)),
                tuple((_moment(first), _moment(last)) for first, last in periods),
                tuple(map(str, models)),
            )
            for code, what, file, line, periods, models in json.loads(stamp.outputs.get(TERMS, ""))
        )
        return load_claims(stamp.outputs.get(_CLAIMS, "")), terms
    except (ValueError, TypeError):
        return None


def placeless_digest(rules: Iterable[SubjectRules]) -> str:
    """Return a digest of rules, independent of where they are written."""
    kinds = (of_subject.kind for of_subject in rules)
    return digest_of_texts(*(part for kind, names in kinds for part in (_kind_digest(kind), repr(names))))


@once_of_kind
def _kind_digest(kind: Kind) -> str:
    return digest(repr(kind))


@lru_cache(maxsize=64)
def load_claims(text: str) -> tuple[Claim, ...]:
    """Return the claims of :func:`dump_claims`.

    Raises:
        ValueError, TypeError: the text was not written by it.
    """
    return tuple(
        Claim(
            str(model),
            str(action),
            tuple(DomainRange(int(first), int(last)) for first, last in domains),
            str(universe),
            Proof.PROVEN,
            excepted=tuple(map(str, excepted)),
        )
        for model, action, domains, universe, excepted in json.loads(text)
    )
