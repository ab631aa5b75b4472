# SPDX-License-Identifier: Apache-2.0
"""The authorities that are trusted beside those in force, while keys are replaced: they revoke what they issued."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from comarmor.errors import Origin
from keymint.api import Authority, SigningAuthority
from keymint.changes import Action, FolderChange, Step
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.plan import authority_files
from keymint.plan.authorities import MintedAuthority
from keymint.plan.authority_files import FORMER, NEXT
from keymint.plan.private_keys import password
from keymint.session import Session


def others(session: Session) -> Mapping[str, tuple[str, MintedAuthority]]:
    """Return the authorities that enclaves trust beside those in force, by the name of their files.

    Returns:
        Each with the name of the authority in force.
    """
    return {
        f"{each.name}.{authority_files.other(each)}": (each.name, _other(session, each))
        for each in session.profile.authorities
        if authority_files.is_bundled(each)
    }


def outdated(session: Session, stage: str) -> Iterator[Step]:
    """Yield what removes the revocation lists of authorities that enclaves trust no more, or not yet."""
    for each in session.profile.authorities:
        for suffix in (NEXT, FORMER):
            path = session.workspace.revocation_list(f"{each.name}.{suffix}")
            if suffix != authority_files.other(each) and session.tree.has_file(path):
                change = FolderChange(path.parent, removed=(path.name,))
                yield Step(stage, f"{each.name}.{suffix}", Action.REMOVED, (change,))


def _other(session: Session, authority: Authority) -> MintedAuthority:
    rollover, spec = authority.issuance.rollover, authority.certificate
    pem = rollover.certificate if rollover else b""
    certificate = certificates.load(pem)
    path = session.workspace.authority_key(f"{authority.name}.{authority_files.other(authority)}")
    where = session.workspace.origin(path)
    content = session.tree.read(path)
    if content is not None:
        try:
            secret = password(spec.key, session.environment, spec.origin)
            key = keys.from_pem(content, secret, where)
        except KeymintError as error:
            return MintedAuthority(certificate, b"", error)
        if keys.matches(key, certificate):
            signer = SigningAuthority(authority.name, pem, content, secret)
            return MintedAuthority(certificate, b"", (certificates.Issuer(certificate, key), signer))
    return MintedAuthority(certificate, b"", _missing(authority.name, where))


def _missing(name: str, where: Origin) -> KeymintError:
    return KeymintError(
        f"the private key that the one of the authority {name!r} is exchanged with is not here, and is needed to sign "
        "its revocation list",
        where=where,
        help="restore it",
        code="authority-key-missing",
    )
