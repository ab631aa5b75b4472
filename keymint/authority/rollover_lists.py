# SPDX-License-Identifier: Apache-2.0
"""The authorities that are trusted beside those in force, while keys are replaced: they revoke what they issued."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from keymint.api import Authority, SigningAuthority
from keymint.authority import authority_files
from keymint.authority.authorities import MintedAuthority
from keymint.authority.authority_files import FORMER, NEXT
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.store.changes import Action, FolderChange, Step
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import password


def others(session: Session) -> Mapping[str, tuple[str, MintedAuthority]]:
    """Return the authorities that enclaves trust beside those in force, by the name of their files.

    Returns:
        Each with the name of the authority in force.
    """
    return {
        authority_files.other(each): (each.name, _other(session, each, rollover.certificate))
        for each in session.profile.authorities
        if (rollover := authority_files.current_rollover(each))
    }


def list_removals(session: Session, stage: str) -> Iterator[Step]:
    """Yield what removes the revocation lists of authorities that enclaves trust no more, or not yet."""
    for each in session.profile.authorities:
        for suffix in (NEXT, FORMER):
            name = f"{each.name}.{suffix}"
            path = session.workspace.revocation_list(name)
            if name != authority_files.other(each) and session.tree.has_file(path):
                yield Step(stage, name, Action.REMOVED, (FolderChange(path.parent, removed=(path.name,)),))


def _other(session: Session, authority: Authority, pem: bytes) -> MintedAuthority:
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
