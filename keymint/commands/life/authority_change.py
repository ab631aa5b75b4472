# SPDX-License-Identifier: Apache-2.0
"""``keymint authority renew``, ``import`` and ``encrypt``: another certificate, or a password, for the same key."""

from __future__ import annotations

from pathlib import Path

from comarmor.values import replace
from keymint.authority import authority_changes as changes
from keymint.authority.authorities import plan_authorities
from keymint.command_line.named_files import read_input
from keymint.command_line.options import authority_argument, flag_day_option
from keymint.command_line.verb import FILE, Report, Run, argument, path_option, verb
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.life.revocation_lists_in_force import list_of
from keymint.stages.pipeline import Request, conduct
from keymint.stages.work import Work
from keymint.store.changes import Plan
from keymint.workspace.installed_enclaves import enclave_names, with_sources
from keymint.workspace.session import Session

REISSUED = "authority-reissued"
"""Code of the warning of :func:`keymint.authority.authorities.plan_authorities`, which knows no transport."""


def given_authority(run: Run, certificate: Path, key: Path | None) -> changes.GivenAuthority:
    """Read the certificate of an authority that was made elsewhere, and its key if it is given.

    Raises:
        KeymintError: a file cannot be read.
    """
    given = changes.GivenAuthority(read_input(run, certificate), Origin(str(certificate)))
    return replace(given, key=read_input(run, key), key_file=Origin(str(key))) if key else given


def issued_again(run: Run, session: Session, first: Plan, name: str, *, flag_day: bool) -> Plan:
    """Return a plan that changes an authority, followed by what all installed enclaves get from it.

    Args:
        run: the run.
        session: the workspace before the plan, and its profile.
        first: what changes the profile, the key and the certificate of the authority.
        name: the authority.
        flag_day: the user accepts that old and new enclaves do not work together.

    Raises:
        KeymintError: an enclave cannot be built, signed or proven; with all defects. Or the plan is a flag day, which
            the user did not accept.
    """
    asks = first.writes() and not flag_day and enclave_names(session)
    if titles := changes.refusing_implementations(session, name, (), "reissues") if asks else ():
        raise KeymintError(
            f"a new certificate of {name!r} requires restarting all robots together: with {' and '.join(titles)}, "
            "subjects with the old one and subjects with the new one cannot communicate",
            where=session.workspace.origin(session.workspace.authority_certificate(name)),
            help=f"plan a common restart of all robots and add --flag-day, or stage a second keystore with "
            f"'keymint authority replace {name}'",
            code="authority-flag-day",
        )
    work = Work(session).then(first)
    changed = work.session
    if names := with_sources(changed):
        refresh = _lists_to_refresh(session, changed, name)
        work = conduct(work, Request(names, refresh=refresh), run.crew)
    else:
        work = work.then(plan_authorities(changed)[0])
    return _told(work.plan, changed, name)


def _lists_to_refresh(session: Session, changed: Session, name: str) -> tuple[str, ...]:
    """Return the authority if its revocation list ends with its certificate, which ends later now, and it can sign."""
    present = list_of(session, name)
    if present is None:
        return ()
    before, after = (plan_authorities(each)[1][name] for each in (session, changed))
    end, later = before.certificate.not_valid_after_utc, after.certificate.not_valid_after_utc
    return (name,) if present.next_update == end < later and after.can_sign else ()


def _told(plan: Plan, session: Session, name: str) -> Plan:
    """Return a plan that says what its change of an authority costs a running fleet."""
    plan = replace(plan, diagnostics=tuple(each for each in plan.diagnostics if each.code != REISSUED))
    if not plan.writes() or not enclave_names(session):
        return plan
    titles = changes.refusing_implementations(session, name, (), "reissues")
    where = session.workspace.origin(session.workspace.authority_certificate(name))
    if titles:
        message = f"the certificate of the authority {name!r} is reissued: all robots restart together"
        help_ = f"copy the keystore to all of them first; {' and '.join(titles)} do not accept both certificates"
    else:
        message = f"the certificate of the authority {name!r} is reissued: robots that have it and others work together"
        help_ = "copy the keystore to each robot before the old certificate ends; nodes read it when they start"
    return plan.noting(Diagnostic.warning(REISSUED, message, where, help_))


@verb(dry_run=True, of="authority")
def authority_renew(run: Run, name: str = authority_argument, flag_day: bool = flag_day_option) -> Report:
    """Issue an authority's certificate again for the same key and name: it begins now, and is valid as long as before.

    All enclaves get the new certificate. If the authority issues identities, robots with the old certificate and
    robots with the new one work together. If it signs documents, these are signed again, and subjects with
    different certificates of it cannot communicate: that needs --flag-day.
    """
    return run.change(
        lambda session: issued_again(run, session, changes.plan_renewal(session, name), name, flag_day=flag_day)
    )


@verb(dry_run=True, of="authority")
def authority_import(
    run: Run,
    name: str = authority_argument,
    certificate: Path = argument(type=FILE),
    key_file: Path | None = path_option("--key", kind=FILE),
    flag_day: bool = flag_day_option,
) -> Report:
    """Use the certificate of an authority that somebody else issued, as it is.

    CERTIFICATE is a PEM file. Its private key may stay elsewhere: then everything that needs no signature by it
    works here. Once enclaves are installed, the certificate must be for the key that they trust; to change the key,
    use 'keymint authority replace'.

    Options:
        key_file: Its private key, which is copied into private/.
    """
    given = given_authority(run, certificate, key_file)
    return run.change(
        lambda session: issued_again(run, session, changes.plan_import(session, name, given), name, flag_day=flag_day)
    )


@verb(dry_run=True, of="authority")
def authority_encrypt(run: Run, name: str = authority_argument) -> Report:
    """Encrypt the private key of an authority in private/, if the profile asks for BestAvailableEncryption.

    The key stays the same, so no enclave changes. The password comes from the environment variable that the profile
    names. Backups and copies keep the plain key: delete them, or replace the key with 'keymint authority replace'.
    """
    return run.change(lambda session: changes.plan_encryption(session, name))
