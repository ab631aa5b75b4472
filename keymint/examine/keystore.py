# SPDX-License-Identifier: Apache-2.0
"""Ask every rule about a keystore, and about a second one that lies beside it: what ``check`` and ``prove`` share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic
from comarmor.text import first_few
from keymint.api import LoadedPolicy, Phase
from keymint.authority.rollover import staged_session
from keymint.errors import KeymintError
from keymint.examine.issued import lists_in_force, of_enclaves, register_findings
from keymint.examine.rights import presented_rights
from keymint.executors import Pool
from keymint.life.earlier_rights import RIGHTS_OUTLIVE
from keymint.names import subject_of
from keymint.stages.proof.proof_results import ProofEffort, ProofResults
from keymint.stages.proof.prove import proofs
from keymint.store import journal
from keymint.workspace.installed_enclaves import INSTALLED, with_sources
from keymint.workspace.session import Inputs, Session, once

SHOWN_NOTES = frozenset({RIGHTS_OUTLIVE, "authority-key-missing", "not-examined"})
"""Codes of notes that are shown in any case: an owner must know of them."""
_REGISTER = "which certificates were issued and revoked is not known"
_KEYS = "no private key here is compared with its certificate"
UNKNOWN_HISTORY = "nothing wider was signed before the register began to keep signed documents"


def proven_keystore(
    session: Session,
    names: Sequence[str],
    policy: LoadedPolicy,
    effort: ProofEffort,
    on_enclave: Callable[[str], None],
    pool: Pool,
) -> ProofResults:
    """Prove the claims about the enclaves of some packages, and about all that their certificates may present.

    Args:
        session: the workspace and its profile.
        names: names of packages.
        policy: the policy that the enclaves are compared with.
        effort: what to claim, and limits of the search.
        on_enclave: called with each name after its proof.
        pool: where else to prove.

    Raises:
        KeymintError: a package has defects, or the pool is lost.
    """
    results = proofs(session, policy, effort, names, on_enclave, pool)
    presented = presented_rights(session, results.state, policy, effort)
    shared, enclaves = (*results.shared, *presented.shared), results.enclaves
    if (ahead := staged_keystore_session(session)) is not None:
        ready = tuple(name for name in with_sources(ahead) if name in names)
        second = proofs(ahead, policy, effort, ready, lambda _: None, pool)
        enclaves, shared = (*enclaves, *second.enclaves), (*shared, *second.shared)
    outliving, is_whole = presented.outliving, presented.is_whole
    return replace(
        results, enclaves=enclaves, shared=shared, state=presented.state, outliving=outliving, is_whole=is_whole
    )


def deciding_findings(session: Session) -> Iterator[Diagnostic]:
    """Yield the findings that may change what a transport decides, beside claims and trust anchors.

    Raises:
        KeymintError: the register or a package has defects.
    """
    records = session.workspace.state
    if journal.load(session.tree.try_read(records / journal.MARK) or b"", records).exchanges:
        message = "a run was interrupted: what it wrote may be incomplete"
        help_ = "repeat its command; every verb that writes finishes what is visible, or drops it"
        yield Diagnostic.warning("run-unfinished", message, session.workspace.origin(records), help_)
    yield from _not_staged(session)
    yield from lists_in_force(session)
    yield from of_enclaves(session)
    yield from register_findings(session)


def _not_staged(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding if a second keystore is staged, and an installed enclave is not in it."""
    if not (name := _staging(session)):
        return
    try:
        ahead = staged_keystore_session(session)
    except KeymintError:  # reported with the second keystore
        return
    if lacking := {*with_sources(session)}.difference(with_sources(ahead) if ahead else ()):
        message = f"lacks {first_few(sorted(map(subject_of, lacking)))}: after the switch they have no enclave"
        where = session.workspace.origin(session.workspace.next_install)
        help_ = f"'keymint authority replace {name}' completes it; copy it to all robots again"
        yield Diagnostic.error("rollover-incomplete", message, where, help_)


def _staging(session: Session) -> str:
    """Return the authority for which a second keystore is staged, or an empty text."""
    phases = ((each.name, each.issuance.rollover) for each in session.profile.authorities)
    return next((name for name, rollover in phases if rollover and rollover.phase is Phase.STAGE), "")


@once
def staged_keystore_session(session: Session) -> Session | None:
    """Return the session of the second keystore as if it were in force; None if there is none.

    Raises:
        KeymintError: the next key is damaged.
    """
    name = _staging(session)
    if not name or not session.tree.names(session.workspace.next_install):
        return None
    ahead = staged_session(session, name)
    return replace(ahead, state=ahead.state.updated(INSTALLED, {}, tuple(ahead.state.stamps.get(INSTALLED, ()))))


def not_examined(inputs: Inputs) -> Iterator[Diagnostic]:
    """Yield a note for each entry of the private space that was left out, or has something in it that was."""
    private, register = inputs.workspace.private, inputs.workspace.register
    reasons = {str(private): f"{_KEYS}, and {_REGISTER}", str(register): _REGISTER}
    for path in dict.fromkeys("/".join(each.split("/")[: len(private.parts) + 1]) for each in inputs.tree.left_out):
        message, where = f"not examined: {reasons.get(path, _KEYS)}", inputs.workspace.origin(path)
        yield Diagnostic.note("not-examined", message, where, "a user who may read it examines it as well")
