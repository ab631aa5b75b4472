# SPDX-License-Identifier: Apache-2.0
"""What the verbs that change an authority have in common: all installed enclaves follow in the same run."""

from __future__ import annotations

from dataclasses import replace

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.changes import Plan
from keymint.commands.reissue import reissued
from keymint.commands.run import Run
from keymint.errors import KeymintError
from keymint.plan.authorities import plan_authorities
from keymint.plan.authority_uses import refusing
from keymint.plan.enclaves import installed
from keymint.plan.revocation import list_of
from keymint.session import Session

REISSUED = "authority-reissued"
"""Code of the warning of :func:`keymint.plan.authorities.plan_authorities`, which knows no transport."""


def require_flag_day(session: Session, name: str, *, accepted: bool) -> None:
    """Require consent to a change after which old and new enclaves do not work together.

    Args:
        session: the workspace before the change, and its profile.
        name: the authority whose certificate changes.
        accepted: the user consents.

    Raises:
        KeymintError: there are installed enclaves, and an implementation does not accept both certificates.
    """
    titles = refusing(session, name, (), "reissues") if installed(session) else ()
    if titles and not accepted:
        raise KeymintError(
            f"a new certificate of {name!r} is a flag day: with {' and '.join(titles)}, subjects that have the old one "
            "and subjects that have the new one do not communicate",
            where=Origin(session.workspace.shown(session.workspace.authority_certificate(name))),
            help=f"plan a common restart of all robots and say --flag-day, or stage a second keystore with "
            f"'keymint authority replace {name}'",
            code="authority-flag-day",
        )


def issued_again(run: Run, session: Session, first: Plan, name: str) -> Plan:
    """Return a plan that changes an authority, followed by what all installed enclaves get from it.

    Args:
        run: the run.
        session: the workspace before the plan, and its profile.
        first: what changes the profile, the key and the certificate of the authority.
        name: the authority.

    Raises:
        KeymintError: an enclave cannot be built, signed or proven; with all defects.
    """
    changed = session.after(first).session()
    names = [each for each in installed(changed) if each in set(changed.packages())]
    if not names:
        minted, _ = plan_authorities(changed)
        return _told(first.then(minted), changed, name)
    refresh = _lists_to_refresh(session, changed, name)
    return _told(first.then(reissued(run, changed, Plan((), changed.state), names, refresh=refresh)), changed, name)


def _lists_to_refresh(session: Session, changed: Session, name: str) -> tuple[str, ...]:
    """Return the authority if its revocation list ends with its certificate, which ends later now, and it can sign."""
    present = list_of(session, name)
    if present is None:
        return ()
    end = present.next_update
    before, after = (plan_authorities(each)[1][name] for each in (session, changed))
    ends_with_it = end == before.certificate.not_valid_after_utc < after.certificate.not_valid_after_utc
    return (name,) if ends_with_it and after.can_sign else ()


def _told(plan: Plan, session: Session, name: str) -> Plan:
    """Return a plan that says what its change of an authority costs a running fleet."""
    others = tuple(each for each in plan.diagnostics if each.code != REISSUED)
    if not plan.writes() or not installed(session):
        return replace(plan, diagnostics=others)
    titles = refusing(session, name, (), "reissues")
    where = Origin(session.workspace.shown(session.workspace.authority_certificate(name)))
    if titles:
        message = f"the certificate of the authority {name!r} is reissued: all robots restart together"
        help_ = f"copy the keystore to all of them first; {' and '.join(titles)} do not accept both certificates"
    else:
        message = f"the certificate of the authority {name!r} is reissued: robots that have it and others work together"
        help_ = "copy the keystore to each robot before the old certificate ends; nodes read it when they start"
    told = Diagnostic(REISSUED, Severity.WARNING, message, where, help_)
    return replace(plan, diagnostics=(*others, told))
