# SPDX-License-Identifier: Apache-2.0
"""The plans of ``keymint authority replace``: each phase, and what must be complete before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from comarmor.errors import Origin
from comarmor.text import counted
from comarmor.values import dataclass
from keymint.api import Phase
from keymint.authority import rollover
from keymint.authority.authorities import authority_named
from keymint.authority.authority_changes import GivenAuthority
from keymint.authority.authority_uses import refusing_implementations
from keymint.errors import KeymintError, usage_error
from keymint.names import subject_of
from keymint.pki import certificates
from keymint.stages import install
from keymint.stages.package_stage import Crew
from keymint.stages.pipeline import Request, conduct
from keymint.stages.second_keystore import dropped_keystore, exchanged_keystore, staged_keystore
from keymint.stages.work import Work
from keymint.store.changes import Plan
from keymint.workspace.installed_enclaves import with_sources
from keymint.workspace.session import Session

_NEXT = {Phase.DISTRIBUTE: Phase.REISSUE, Phase.REISSUE: Phase.END, Phase.STAGE: Phase.END}
"""The phase that follows each."""


@dataclass(frozen=True, slots=True)
class PhaseRequest:
    """What the user asks for.

    Attributes:
        phase: the phase to reach; None to begin, or to complete the one that was reached.
        cancel: give up.
        vendors: names of the implementations that the fleet has; empty for all.
        given: the next authority, if it was made elsewhere.
    """

    phase: Phase | None = None
    cancel: bool = False
    vendors: tuple[str, ...] = ()
    given: GivenAuthority | None = None


def phase_plan(crew: Crew, session: Session, name: str, request: PhaseRequest) -> Plan:
    """Return the plan of a phase; of one that was reached already, what is missing.

    Raises:
        KeymintError: the request does not fit to the phase that was reached, the phase before is not complete, or an
            enclave cannot be built, signed or proven; with all defects.
    """
    phase, names = rollover.phase_of(session, name), _names(session, name)
    if request.cancel:
        return _cancelled(crew, session, name, names)
    if phase is None:
        if request.phase is Phase.END:
            return _ended(crew, session, name, names)
        return _begun(crew, session, name, names, request)
    _require_same_begin(session, name, phase, request)
    following = _NEXT[phase]
    if rollover.is_interrupted(session, name) and request.phase in {None, following}:
        return _went_on(crew, session, name, names)
    if request.phase in {None, phase}:
        return _completed(crew, Work(session), name, names, phase)
    if request.phase is not following:
        raise usage_error(
            f"the key of the authority {name!r} is in the phase {phase}: {request.phase} does not follow it",
            f"'keymint authority replace {name} --phase {following}' does",
        )
    if phase is Phase.STAGE:
        require_staged(crew, session, name)
    else:
        completed = f"'keymint authority replace {name}' completes it; then copy the keystore to all robots"
        _require_current(session, names, f"the keystore of the phase {phase}", completed)
    return _went_on(crew, session, name, names)


def _names(session: Session, name: str) -> Sequence[str]:
    """Return the packages whose enclaves follow.

    Raises:
        KeymintError: nothing is installed.
    """
    authority_named(session, name)
    names = with_sources(session)
    if not names:
        raise KeymintError(
            "nothing is installed, so nobody trusts an authority yet",
            help=f"'keymint install --new-authority {name}' makes a new one at once",
            code="enclave-missing",
        )
    return names


def _require_same_begin(session: Session, name: str, phase: Phase, request: PhaseRequest) -> None:
    """Require that a request which begins is the one that began: it may be given again after it was killed.

    Raises:
        KeymintError: it names another way or another authority.
    """
    issuance = authority_named(session, name).issuance
    way = Phase.STAGE if refusing_implementations(session, name, request.vendors, "bundles") else Phase.DISTRIBUTE
    same = phase is way if request.vendors else True
    if request.given and issuance.rollover:
        same = same and certificates.load(request.given.certificate) == certificates.load(issuance.rollover.certificate)
    if not same:
        raise usage_error(
            f"the key of the authority {name!r} is being replaced already (phase {phase})",
            "leave --vendor, --certificate and --key out; or --cancel it first",
        )


def _begun(crew: Crew, session: Session, name: str, names: Sequence[str], request: PhaseRequest) -> Plan:
    refused = refusing_implementations(session, name, request.vendors, "bundles")
    phase = request.phase or (Phase.STAGE if refused else Phase.DISTRIBUTE)
    if phase is Phase.REISSUE:
        raise KeymintError(
            f"the key of the authority {name!r} is not being replaced",
            help=f"'keymint authority replace {name}' begins",
            code="rollover-none",
        )
    if phase is Phase.DISTRIBUTE and refused:
        raise KeymintError(
            f"{' and '.join(refused)} cannot trust two authorities {name!r} at once",
            help="stage a second keystore: leave --phase out; or name what the fleet has with --vendor",
            code="rollover-no-bundle",
        )
    _require_current(session, names, "the present keystore", "'keymint build' and 'keymint install' complete it")
    work = Work(session).then(rollover.plan_begin(session, name, phase, request.given))
    return _completed(crew, work, name, names, phase)


def _completed(crew: Crew, work: Work, name: str, names: Sequence[str], phase: Phase) -> Plan:
    """Return what is missing of a phase."""
    work = conduct(work, Request(names), crew)
    return work.then(staged_keystore(crew, work.session, name, names)).plan if phase is Phase.STAGE else work.plan


def _went_on(crew: Crew, session: Session, name: str, names: Sequence[str]) -> Plan:
    """Return the plan of the next phase; of one that a killed run began, what is missing."""
    phase = rollover.phase_of(session, name)
    if phase is Phase.STAGE:
        return exchanged_keystore(crew, session, name, names)
    first = rollover.plan_switch(session, name) if phase is Phase.DISTRIBUTE else rollover.plan_end(session, name)
    return conduct(Work(session).then(first), Request(names), crew).plan


def _ended(crew: Crew, session: Session, name: str, names: Sequence[str]) -> Plan:
    """Return what is missing of an end that a killed run began; nothing is if there was none."""
    first = Plan((*rollover.left_over(session, name), *dropped_keystore(session)), session.state)
    return conduct(Work(session).then(first), Request(names), crew).plan


def _cancelled(crew: Crew, session: Session, name: str, names: Sequence[str]) -> Plan:
    if rollover.phase_of(session, name) is None:
        return _ended(crew, session, name, names)
    first = rollover.plan_cancel(session, name)
    first = replace(first, steps=(*first.steps, *dropped_keystore(session)))
    return conduct(Work(session).then(first), Request(names), crew).plan


def _require_current(session: Session, names: Sequence[str], what: str, help_: str) -> None:
    """Require that all enclaves are as the sources and the authorities say.

    Raises:
        KeymintError: one is not, so a phase would begin before the one before it is complete.
    """
    stale = [each for each in names if not install.is_current(session, each)]
    if stale:
        raise KeymintError(
            f"{what} is not complete: {counted(len(stale), 'enclave')} not up to date, e.g. {subject_of(stale[0])}",
            where=session.workspace.origin(session.enclave_folder(stale[0])),
            help=help_,
            code="rollover-incomplete",
        )


def require_staged(crew: Crew, session: Session, name: str) -> None:
    """Require that the second keystore of an authority's replacement is complete and as the sources say.

    Raises:
        KeymintError: it is not.
    """
    if staged_keystore(crew, session, name, _names(session, name)).writes():
        shown = session.workspace.shown(session.workspace.next_install)
        raise KeymintError(
            "the second keystore is not as the sources and the authorities say now",
            where=Origin(shown),
            help=f"'keymint authority replace {name}' brings it up to date; copy it to all robots again",
            code="rollover-incomplete",
        )
