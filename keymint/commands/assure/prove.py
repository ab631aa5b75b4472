# SPDX-License-Identifier: Apache-2.0
"""``keymint prove``: prove that installed documents permit exactly what the policy allows, for all names."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

import click

from comarmor.text import quantity
from keymint.api import Claim, Counterexample, PolicyDecision, Proof, Verdict
from keymint.command_line.options import Names, Number, names_group, standard_option, strict_option, vendors_of_option
from keymint.command_line.verb import Report, Run, findings_exit, findings_if, option, verb
from keymint.errors import Diagnostic, ExitCode, KeymintError
from keymint.examine import keystore
from keymint.life import terms
from keymint.life.examine import orphan_findings
from keymint.life.workspace_register import has_register, with_enclaves, withdrawn
from keymint.output.json import line_json
from keymint.stages.create import subjects_without_package
from keymint.stages.proof_results import STATES, EnclaveProof, ProofEffort, ProofResults, proof_findings
from keymint.stages.prove import NO_PROVER, STAGE
from keymint.stages.trust_anchors import differences
from keymint.store.changes import Action, Step
from keymint.workspace.installed_enclaves import not_installed
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session

SHOWN = 5
"""Number of unprotected topics in the summary; ``--json`` lists all of them."""


@verb(dry_run=True, processes=True)
def prove(
    run: Run,
    names: Names = names_group("ENCLAVE"),
    seconds: float = option(type=Number(0), metavar="S", default=math.inf),
    states: int = option(type=click.IntRange(1), metavar="N", default=STATES, show_default=True, hidden=True),
    allow_vendor_specific: bool = standard_option,
    strict: bool = strict_option,
    distro: str | None = vendors_of_option,
) -> Report:
    """Prove that installed documents permit exactly what the policy allows, for all names.

    Reads the documents in install/ as the transport's standard does, and as each vendor that the distribution ships,
    and compares them with the policy for all names at once. A difference is shown as a shortest counterexample, with
    the rule of the policy and the rule of the document. Proofs are cached until something changes; validity periods
    are checked on each run. -v lists the assumptions of the proof. ENCLAVE is a package [all].
    docs/verification.md says in one table what each verb reads.

    Exit code 3: a claim is refuted or unknown, or with --strict has an exception; a certificate or grant is expired or
    not yet valid; an enclave does not trust the workspace's authorities; or an enclave has no source package.

    Options:
        seconds: Also stop after this time per enclave; undecided claims are unknown [no limit].
        states: Stop after this many states per question.
    """
    session = run.session(auditing=True).for_vendors_of(distro)
    chosen = with_enclaves(session, names.packages(run, session), named=bool(names))
    try:
        policy = lazy_policy(session)  # loaded only if something is to be proven
    except KeymintError as error:
        return _without_policy(run, session, chosen, error)
    with run.console.progress(len(chosen), run.setting.monotonic) as advance:
        effort = ProofEffort(run.setting.monotonic, states, seconds, standard_only=allow_vendor_specific)
        results = keystore.proven_keystore(
            session, chosen, policy, effort,
            lambda name: advance(Step(STAGE, name, Action.UNCHANGED)), run.pool,
        )  # fmt: skip
    unknown: tuple[Diagnostic, ...] = ()
    if not names:
        gone = (not_installed(name, "", reason) for name, reason in withdrawn(session).items())
        unknown = (*orphan_findings(session), *subjects_without_package(session, policy, session.packages()), *gone)
    # What holds for another distribution is a result to show: no later run may rely on it.
    unrecorded = () if session.vendors_of else run.keep(session, results.state)

    unexamined, with_register = tuple(keystore.not_examined(session)), has_register(session)
    _summary(run, results, with_register=with_register)
    ahead = keystore.staged_keystore_session(session)
    beside = keystore.of_second_keystore(session, keystore.deciding_findings(ahead)) if ahead else ()
    more = dict.fromkeys((*keystore.deciding_findings(session), *beside))
    found = (*proof_findings(session, results, strict=strict), *more, *unknown)
    diagnostics = [*_assumptions(results), *found, *unrecorded, *unexamined]
    in_force = _until(results) is not None and (with_register or None)
    result = _result(run, results, unexamined, in_force)
    exit_code = findings_if(findings_exit(found) or (strict and results.outliving))
    return run.report(result, diagnostics, exit_code, workspace=session.workspace, notes=keystore.SHOWN_NOTES)


def _without_policy(run: Run, session: Session, names: Sequence[str], error: KeymintError) -> Report:
    """Return what can be told although the policy cannot be read: what the authorities do not vouch for."""
    run.console.line(f"proved nothing about {quantity(len(names), 'enclave')}: the policy cannot be read")
    found = (*error.diagnostics, *differences(session, names), *keystore.deciding_findings(session))
    unexamined = tuple(keystore.not_examined(session))
    nothing = ProofResults((), (), session.state, {}, frozenset(), {}, session.now)
    result = _result(run, nothing, unexamined, None)
    diagnostics = tuple(dict.fromkeys((*found, *orphan_findings(session), *unexamined)))
    return run.report(result, diagnostics, ExitCode.FINDINGS, workspace=session.workspace, notes=keystore.SHOWN_NOTES)


def _result(run: Run, results: ProofResults, unexamined: Sequence[Diagnostic], in_force: bool | None) -> dict[str, Any]:
    return {
        "at": terms.iso_time(results.now),
        "until": _shown(_until(results)),
        "in_force": in_force,
        "not_examined": len(unexamined),
        "assumptions": _taken(results),
        "models": {model: results.evidence.get(model) for model in _taken(results)},
        "enclaves": [_enclave(enclave, results.now, run) for enclave in results.enclaves],
        "shared": [_across(each, results.now, run) for each in results.shared],
    }


def _summary(run: Run, results: ProofResults, *, with_register: bool) -> None:
    count, say = len(results.enclaves), run.console.line
    total = sum(len(enclave.claims) for enclave in results.all)
    open_ = [claim for enclave in results.all for claim in enclave.claims if claim.proof is not Proof.PROVEN]
    refuted = sum(claim.proof is Proof.COUNTEREXAMPLE for claim in open_)
    unread = sum(
        any(diagnostic.code != NO_PROVER for diagnostic in enclave.diagnostics) for enclave in results.enclaves
    )
    cached = sum(enclave.cached for enclave in results.enclaves)
    parts = [f"{total - len(open_)} of {total} claims proven"]
    parts += [f"{refuted} refuted"] * bool(refuted)
    parts += [f"{len(open_) - refuted} unknown"] * (len(open_) > refuted)
    parts += [f"{quantity(unread, 'enclave')} could not be read"] * bool(unread)
    models = ", ".join(_with_evidence(results))
    of_these = f" ({cached} cached)" if cached else ""
    enclaves = f"{quantity(count, 'enclave')}{of_these}{f' for {models}' if models else ''}"
    say(f"proved {enclaves}: {', '.join(parts)}{_when(results, with_register=with_register)}")
    if excepted := list(dict.fromkeys(_excepted(results))):
        left = len(excepted) - SHOWN
        more = f"; and {left} more (--json names them)" if left > 0 else ""
        say(f"not part of the proof: {'; '.join(excepted[:SHOWN])}{more}")


def _until(results: ProofResults) -> datetime | None:
    """Return the end of the validity of all claims, or None if something is not valid now."""
    return terms.end([term for enclave in results.enclaves for term in enclave.terms], results.now)


def _when(results: ProofResults, *, with_register: bool) -> str:
    """Return the validity of the claims, in words; without the register revocations are not known."""
    if not any(enclave.terms for enclave in results.enclaves):
        return ""
    until = _until(results)
    if until is not None:
        known, limit = "in force", ""
        if not with_register:
            known, limit = "valid by their dates", " (whether they were revoked is not known without the register)"
        return f"; {known} at {terms.iso_time(results.now)}, until {terms.iso_time(until)}{limit}"
    out = sum(terms.end(enclave.terms, results.now) is None for enclave in results.enclaves if enclave.terms)
    return f"; {quantity(out, 'enclave')} {'is' if out == 1 else 'are'} not in force at {terms.iso_time(results.now)}"


def _shown(moment: datetime | None) -> str | None:
    return None if moment is None else terms.iso_time(moment)


def _excepted(results: ProofResults) -> Iterator[str]:
    """Yield the exceptions of the proven claims: what the sources leave open on purpose."""
    for enclave in results.all:
        for claim in enclave.claims:
            yield from (f"{enclave.subject or 'all subjects'}, {exception}" for exception in claim.excepted)


def _with_evidence(results: ProofResults) -> Iterator[str]:
    """Yield the models with a claim about an enclave, and how each is known if no specification says it."""
    claimed = {claim.model for enclave in results.enclaves for claim in enclave.claims}
    for model in _taken(results):
        if model in claimed or not claimed:
            how = "" if model in results.standards else results.evidence.get(model, "")
            yield f"{model} ({how})" if how else model


def _taken(results: ProofResults) -> Mapping[str, Sequence[str]]:
    """Return the assumptions of each model with a claim."""
    claimed = {claim.model for enclave in results.all for claim in enclave.claims}
    return {model: lines for model, lines in results.assumptions.items() if model in claimed or not claimed}


def _assumptions(results: ProofResults) -> Iterator[Diagnostic]:
    """Yield each assumption once, with the models that make it."""
    lines: dict[str, list[str]] = {}
    if not results.is_whole:
        yield Diagnostic.note("assumption", f"assumption: {keystore.UNKNOWN_HISTORY}")
    for model, assumed in _taken(results).items():
        for line in assumed:
            lines.setdefault(line, []).append(model)
    for line, models in lines.items():
        yield Diagnostic.note("assumption", f"assumption ({', '.join(models)}): {line}")


def legible(name: str) -> str:
    r"""Return a name as text for JSON; a byte that is not UTF-8 becomes ``\xNN``."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def _enclave(enclave: EnclaveProof, now: datetime, run: Run) -> dict[str, Any]:
    until = {each.model: terms.end(terms.terms_of(enclave.terms, {each.model}), now) for each in enclave.claims}
    return {
        "subject": enclave.subject,
        "proof": _whole(enclave),
        "until": _shown(terms.end(enclave.terms, now)),
        "unchanged": enclave.cached,
        "claims": [_claim(claim, until[claim.model], run) for claim in enclave.claims],
    }


def _across(proof: EnclaveProof, now: datetime, run: Run) -> dict[str, Any]:
    """Return claims across subjects, in the form of an enclave's."""
    document = _enclave(proof, now, run)
    return {"build_type": proof.build_types[0], "proof": document["proof"], **document, "subject": None}


def _whole(enclave: EnclaveProof) -> Proof:
    proofs = {claim.proof for claim in enclave.claims}
    if Proof.COUNTEREXAMPLE in proofs:
        return Proof.COUNTEREXAMPLE
    return Proof.UNKNOWN if enclave.diagnostics or Proof.UNKNOWN in proofs else Proof.PROVEN


def _claim(claim: Claim, until: datetime | None, run: Run) -> dict[str, Any]:
    return {
        "model": claim.model,
        "action": claim.action,
        "domains": [{"first": each.first, "last": each.last} for each in claim.domains],
        "universe": claim.universe,
        "proof": claim.proof,
        "except": claim.excepted,
        "until": _shown(until),
        "reason": claim.reason,
        "counterexample": None if claim.counterexample is None else _counterexample(claim.counterexample, run),
    }


def _counterexample(counterexample: Counterexample, run: Run) -> dict[str, Any]:
    meaning = counterexample.meaning
    return {
        "name": legible(counterexample.endpoint.name) or None,
        "partitions": [legible(each) for each in counterexample.endpoint.partitions],
        "domain": counterexample.endpoint.domain,
        "ros": meaning and {"kind": meaning.object.kind, "permission": meaning.permission, "name": meaning.object.name},
        "policy": _decision(counterexample.policy, run),
        "document": {**_decision(counterexample.document, run), "deviation": counterexample.document.deviation},
    }


def _decision(decision: PolicyDecision | Verdict, run: Run) -> dict[str, Any]:
    where = line_json(decision.where, run.typed) or {"file": None, "line": None}
    return {"allowed": decision.allowed, "reason": str(decision.reason), **where}
