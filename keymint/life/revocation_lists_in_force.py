# SPDX-License-Identifier: Apache-2.0
"""The revocation lists of a workspace: one for each authority that ever revoked a certificate.

The register says what is revoked. A list that a killed run did not write is written by the next run that can sign.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from datetime import datetime

from comarmor.text import hexadecimal
from keymint.api import Authority, SigningAuthority
from keymint.authority import authority_files
from keymint.authority.authorities import MintedAuthority
from keymint.authority.authority_files import FORMER, NEXT
from keymint.errors import KeymintError, Origin
from keymint.life.register import Register
from keymint.life.workspace_register import installed_lists, issuer_of, outdated_register, register_change, register_of
from keymint.pki import certificates, keys, revocation_lists
from keymint.pki.revocation_lists import Revocation, RevocationList
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.workspace.session import Session, once
from keymint.workspace.stored_keys import password

STAGE = "crl"


@once
def lists(session: Session) -> Mapping[str, bytes]:
    """Return the revocation lists in the public space, PEM, by authority.

    While the key of an authority is replaced, there may be one more: ``NAME.next`` or ``NAME.former``.
    """
    names = [authority.name for authority in session.profile.authorities]
    bundled = filter(authority_files.current_rollover, session.profile.authorities)
    names += map(authority_files.other, bundled)
    contents = {name: session.tree.read(session.workspace.revocation_list(name)) for name in names}
    return {name: content for name, content in contents.items() if content is not None}


@once
def list_of(session: Session, name: str) -> RevocationList | None:
    """Return the revocation list of an authority, or None if it has none.

    Raises:
        KeymintError: it cannot be read.
    """
    content, path = lists(session).get(name), session.workspace.revocation_list(name)
    return None if content is None else revocation_lists.load(content, session.workspace.origin(path))


def loaded_lists(session: Session) -> Mapping[str, RevocationList]:
    """Return the revocation lists of :func:`lists`, read; errors as :func:`list_of`."""
    return {name: found for name in lists(session) if (found := list_of(session, name))}


def enclave_lists(session: Session) -> Mapping[str, bytes]:
    """Return the revocation lists that enclaves have as files of their own, PEM, by authority.

    Where they trust two authorities, the file of these has the lists; see
    :func:`keymint.authority.authority_files.trusted_chains`.
    """
    own = {each.name for each in session.profile.authorities if not authority_files.current_rollover(each)}
    return {name: content for name, content in lists(session).items() if name in own}


def plan_lists(
    session: Session,
    authorities: Mapping[str, MintedAuthority],
    *,
    register: Register | None = None,
    refresh: Collection[str] = (),
    end: datetime | None = None,
) -> Plan:
    """Plan the revocation lists that the register demands; one that is right stays as it is.

    Args:
        session: the workspace and its profile.
        authorities: the authorities by name, as they will be.
        register: the register as it will be; the one on the disk by default.
        refresh: authorities whose list is issued again in any case.
        end: nextUpdate of the lists that are issued, UTC; the end of the authority's certificate by default.

    Raises:
        KeymintError: a list has revocations that the register does not know, is by another authority, or must be
            issued by an authority that cannot sign lists or whose key is not here.
    """
    register = register_of(session) if register is None else register
    suffixed = [(each, f"{each.name}.{suffix}") for each in session.profile.authorities for suffix in (NEXT, FORMER)]
    # Enclaves do not trust the issuers of these any more, or not yet.
    former = [name for each, name in suffixed if name != authority_files.other(each)]
    steps = [step for name in former for step in _removal(session, name)]
    # Those that enclaves trust beside those in force, by the name of their files.
    others = {
        authority_files.other(each): (each.name, _other(session, each, rollover.certificate))
        for each in session.profile.authorities
        if (rollover := authority_files.current_rollover(each))
    }
    all_authorities = {**authorities, **{name: minted for name, (_, minted) in others.items()}}
    present_lists = {name: _present(session, name, minted, refresh) for name, minted in all_authorities.items()}
    issuers = {name: issuer_of(minted.certificate) for name, minted in all_authorities.items()}
    having = {*refresh, *(name for name, each in issuers.items() if present_lists[name] or register.revoked(each))}
    # Where enclaves trust two authorities and one of them has a list, vendors demand one of each.
    pairs = ({in_force, name} for name, (in_force, _) in others.items())
    paired = {name for pair in pairs if pair & having for name in pair}
    for name, minted in all_authorities.items():
        path, issuer, present = session.workspace.revocation_list(name), issuers[name], present_lists[name]
        revoked = {each.serial: each for each in register.revoked(issuer)}
        if present is not None and session.tree.has_file(session.workspace.register):
            _require_known(session, present, revoked, session.workspace.origin(path))
        if present is None and not revoked and name not in refresh and name not in paired:
            steps += _removal(session, name)  # by an earlier authority of this name, which nobody trusts any more
            continue
        serials = {each.serial for each in present.revocations} if present else frozenset[int]()
        # A list that begins later than now was issued by a clock that was ahead; but none begins before its authority.
        begins = max(session.now, minted.certificate.not_valid_before_utc)
        in_force = present is not None and present.this_update <= begins and session.now < present.next_update
        if in_force and serials >= revoked.keys() and name not in refresh:
            continue
        number = 1 + max(register.numbers.get(issuer, 0), present.number if present else 0)
        where = session.workspace.origin(session.workspace.authority_certificate(name))
        revocation_lists.require_signs_lists(minted.certificate, where)
        revocations = [Revocation(each.serial, each.revoked or session.now, each.reason) for each in revoked.values()]
        pem = revocation_lists.issue(minted.issuer, revocations, number, session.now, end)
        register = register.with_number(issuer, number)
        action = Action.UPDATED if present else Action.CREATED
        detail = f"number {number}, {len(revocations)} revoked"
        steps.append(Step(STAGE, name, action, (FolderChange(path.parent, {path.name: File(pem)}),), detail))
    return Plan(tuple(steps), session.state, first=register_change(session, register))


def _removal(session: Session, name: str) -> Iterator[Step]:
    """Yield what removes the revocation list of an authority that nobody trusts, if there is one."""
    path = session.workspace.revocation_list(name)
    if session.tree.has_file(path):
        yield Step(STAGE, name, Action.REMOVED, (FolderChange(path.parent, removed=(path.name,)),))


def _other(session: Session, authority: Authority, pem: bytes) -> MintedAuthority:
    """Return the authority that enclaves trust beside the one in force, given its certificate."""
    certificate, name = certificates.load(pem), authority_files.other(authority)
    try:
        found = authority_files.stored_key(session, authority, name)
    except KeymintError as error:
        return MintedAuthority(certificate, error)
    if found and keys.matches(found[1], certificate):
        signer = SigningAuthority(authority.name, pem, found[0], password(session, authority.certificate))
        return MintedAuthority(certificate, (certificates.Issuer(certificate, found[1]), signer))
    where = session.workspace.origin(session.workspace.authority_key(name))
    missing = authority_files.key_elsewhere(name, where, "restore it: it signs a revocation list")
    return MintedAuthority(certificate, missing)


def _present(session: Session, name: str, minted: MintedAuthority, refresh: Collection[str]) -> RevocationList | None:
    """Return the list of an authority, or None if it has none or one of an earlier authority of this name.

    Raises:
        KeymintError: the list is damaged, and not issued again from the register.
    """
    path = session.workspace.revocation_list(name)
    content, shown = session.tree.read(path), session.workspace.origin(path)
    if content is None:
        return None
    try:
        present = revocation_lists.load(content, shown)
    except KeymintError:
        if name in refresh and session.tree.has_file(session.workspace.register):
            return None
        raise
    return None if revocation_lists.problem(content, minted.certificate) else present


def require_lists_known(session: Session, register: Register) -> None:
    """Require that the register knows all revocations of the lists that installed enclaves have.

    Args:
        session: the workspace and its profile.
        register: the register, by which a key that had a certificate before is certified again.

    Raises:
        KeymintError: it does not, so it is an old one, and the key may be one that was revoked.
    """
    for *_, authority in authority_files.issuers(session):
        revoked = {each.serial for each in register.revoked(issuer_of(authority))}
        for where, found in installed_lists(session, authority):
            _require_known(session, found, revoked, where)


def _require_known(session: Session, present: RevocationList, revoked: Collection[int], where: Origin) -> None:
    """Require that the register knows all revocations of a list: revocations are never taken back.

    Raises:
        KeymintError: it does not, so it is an old one.
    """
    unknown = [each for each in present.revocations if each.serial not in revoked]
    if unknown:
        what = f"{len(unknown)} of the revocations in {where}, e.g. of the serial number "
        raise outdated_register(session, f"{what}{hexadecimal(unknown[0].serial)}: it is older than the list")


def require_nothing_lost(before: bytes | None, after: bytes | None, where: Origin) -> None:
    """Require that a list which replaces another one in an enclave has all its revocations.

    Args:
        before: the list that is there, or None.
        after: the list that replaces it; None if there is no list any more.
        where: its file, for messages.

    Raises:
        KeymintError: it lacks one, e.g. because somebody made the other list by hand.
    """
    try:
        found = revocation_lists.load(before or b"", where)
    except KeymintError:
        return  # no node starts with what cannot be read
    new = None if after is None else revocation_lists.load(after, where)
    serials = {each.serial for each in new.revocations} if new else frozenset[int]()
    lost = [each for each in found.revocations if each.serial not in serials]
    if lost and (new is None or found.issuer == new.issuer):
        message = f"revokes certificates that the new list does not, e.g. serial number {hexadecimal(lost[0].serial)}"
        help_ = "restore the register of issued certificates; or move the list away if they may be accepted again"
        raise KeymintError(message, where=where, help=help_, code="revocation-list-foreign")
