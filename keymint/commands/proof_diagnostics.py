"""Report claims that are refuted or unknown: one line per cause, at the unsigned document before it is signed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from comarmor.errors import Diagnostic, Severity
from keymint.api import Claim, Counterexample, Proof
from keymint.commands.run import Run
from keymint.graph import Edge
from keymint.plan import terms
from keymint.plan.prove import EnclaveProof, ProofEffort, ProofResults
from keymint.session import Session

SECONDS = 10.0
STATES = 500_000
OF_DOMAINS = frozenset(("join", "protect"))
"""Actions of claims about a domain, not about a topic; see :class:`keymint.api.Claim`."""
_FIRST = b"<?xml"
"""Start of a document; in a signed file the S/MIME headers precede it."""


def unsigned(found: Diagnostic, session: Session) -> Diagnostic:
    """Return a finding with places in the unsigned documents for those in the signed files that are only planned.

    Args:
        found: the finding; it names files of the enclave as if they lay in ``build/``.
        session: the workspace as it will be, and its profile.
    """
    name = found.subject.removeprefix("/")
    workspace = session.workspace
    folder = workspace.shown(workspace.build / name)
    enclave = session.enclaves / name

    def line(file: str, number: int) -> int:
        head, _, _ = (session.tree.read(enclave / f"{file}.p7s") or b"").partition(_FIRST)
        return number - head.count(b"\n")

    def place(match: re.Match[str]) -> str:
        return f"{folder}/{match[1]}.xml:{line(match[1], int(match[2]))}"

    message = re.sub(re.escape(folder) + r"/(\w+)\.p7s:(\d+)", place, found.message)
    where = found.where
    if where and where.file.startswith(f"{folder}/") and where.file.endswith(".p7s"):
        file = where.file.removeprefix(f"{folder}/").removesuffix(".p7s")
        shown = f"{folder}/{file}.xml"
        where = replace(where, file=shown, line=line(file, where.line) if where.line else 0)
    return replace(found, message=message, where=where)


def alike(refused: Iterable[Diagnostic], shown: Callable[[str], str]) -> Iterator[Diagnostic]:
    """Yield diagnostics, merging those with the same cause in several packages.

    Args:
        refused: diagnostics, each of one subject.
        shown: returns the directory of a package's documents as messages print it.
    """
    groups: dict[tuple[str, str, str], list[Diagnostic]] = {}
    for found in refused:
        folder = shown(found.subject.removeprefix("/"))
        text = found.message.removeprefix(found.subject).replace(f"{folder}/", "")
        place = str(found.where).removeprefix(f"{folder}/") if found.where else ""
        groups.setdefault((found.code, text, place), []).append(found)
    for group in groups.values():
        count = len({found.subject for found in group})
        yield group[0] if count == 1 else replace(group[0], message=f"{group[0].message} [{count} packages]")


def effort_of(run: Run, states: int = STATES, seconds: float = SECONDS) -> ProofEffort:
    """Return the limits of a proof: states per question, seconds per enclave."""
    return ProofEffort(states, lambda: _deadline(run.setting.monotonic, seconds))


def _deadline(clock: Callable[[], float], seconds: float) -> Callable[[], bool]:
    end = clock() + seconds
    return lambda: clock() < end


def dated_of(found: ProofResults) -> Iterator[Diagnostic]:
    """Yield certificates and grants that are not valid at the time of the claims."""
    for enclave in found.enclaves:
        yield from terms.findings(enclave.terms, found.now, enclave.subject)


def diagnostics_of(enclave: EnclaveProof) -> Iterator[Diagnostic]:
    """Yield the diagnostics of an enclave, merging the same result of several models."""
    yield from enclave.diagnostics
    together: dict[tuple[object, ...], list[Claim]] = {}
    for claim in enclave.claims:
        if claim.counterexample is not None:
            found = claim.counterexample
            key = (found.endpoint, found.policy, found.document.allowed, found.document.line, found.document.reason)
            together.setdefault(key, []).append(claim)
        elif claim.proof is Proof.UNKNOWN:
            together.setdefault((claim.reason,), []).append(claim)
    for claims in together.values():
        models = ", ".join(dict.fromkeys(claim.model for claim in claims))
        counterexample = claims[0].counterexample
        if counterexample is None:
            actions = " and ".join(dict.fromkeys(claim.action for claim in claims))
            message = f"{enclave.subject}, {actions}: not proven for {models}: {claims[0].reason}"
            spent = "raise --seconds or --states, or simplify the rules"
            help_ = spent if claims[0].spent else ""
            yield Diagnostic("not-proven", Severity.ERROR, message, None, help_, enclave.subject)
        else:
            yield _refutation(enclave.subject, counterexample, models)


def _refutation(subject: str, found: Counterexample, models: str) -> Diagnostic:
    endpoint, policy, document = found.endpoint, found.policy, found.document
    where = policy.where or (None if document.line else document.where)
    by_document = f"{document.where}: {document.reason}" if document.where else document.reason
    if endpoint.permission in OF_DOMAINS:
        message = f"{subject}: {policy.reason}; {by_document} [{models}]"
        return Diagnostic("counterexample", Severity.ERROR, message, where, found.help, subject)
    may = "permits" if document.allowed else "does not permit"
    says = "allows" if policy.allowed else "does not allow"
    name = f"{endpoint.object.name!r}" + "".join(f" in the partition {p!r}" for p in endpoint.object.partitions)
    ros = f" ({_entity(found.meaning)})" if found.meaning else ""
    domain = f" in domain {endpoint.domain}" if endpoint.domain else ""
    message = (
        f"{subject}: the document {may} it to {endpoint.permission} {name}{ros}{domain}, but the policy {says} it: "
        f"{policy.reason}; {by_document} [{models}]"
    )
    deviation = f"; docs/vendors.md, {document.deviation}" if document.deviation else ""
    help_ = f"a shortest counterexample{deviation}{f'; {found.help}' if found.help else ''}"
    return Diagnostic("counterexample", Severity.ERROR, message, where, help_, subject)


def _entity(meaning: Edge) -> str:
    return f"the {meaning.object.kind.replace('ros_', 'ROS ')} {meaning.object.name}"
