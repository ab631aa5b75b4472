# SPDX-License-Identifier: Apache-2.0
"""Judge what a keystore lacks that Keymint would have made: the steps of ``keymint harden``, each with its cost."""

from __future__ import annotations

from enum import StrEnum

from comarmor.values import Data
from keymint.authority.authority_changes import uses
from keymint.authority.authority_files import read_files
from keymint.errors import Diagnostic
from keymint.pki import foreign_authorities
from keymint.pki.distinguished_names import parse, unique_suffix
from keymint.workspace.session import Session


class Weakness(StrEnum):
    """What a step mends."""

    NAMES = "names"
    """Subject names have no RDN that is unique to the subject."""
    AUTHORITY = "authority"
    """One authority issues identities and signs documents."""
    IDENTIFIERS = "identifiers"
    """The certificate of an authority lacks its key identifier or the permission to sign revocation lists."""


class OpenStep(Data):
    """A step that is open.

    Attributes:
        step: what it mends.
        concerns: packages or authorities.
        cost: what it costs, in words.
    """

    step: Weakness
    concerns: tuple[str, ...]
    cost: str


def open_steps(session: Session) -> tuple[OpenStep, ...]:
    """Return the steps that are open, in the order in which they cost least.

    Raises:
        KeymintError: a package has defects.
    """
    found = []
    if both := signing_issuers(session):
        cost = "requires restarting all robots together with the new keystore: all documents are signed again"
        found.append(OpenStep(Weakness.AUTHORITY, both, cost))
    if lacking := tuple(lacks(session)):
        signs = {name for name in lacking if any(each.signs for each in uses(session).get(name, ()))}
        cost = "nothing restarts: robots with the old and with the new certificate of the authority work together"
        if signs:
            cost = f"requires restarting all robots together, since {', '.join(sorted(signs))} signs documents"
        if signs and both:
            cost += f"; not if you do '{Weakness.AUTHORITY}' first"
        found.append(OpenStep(Weakness.IDENTIFIERS, lacking, cost))
    if plain := tuple(name for name in session.packages() if not _is_unique(session, name)):
        cost = "each enclave gets a new certificate and new permissions: copy it, and restart its nodes and no others"
        found.append(OpenStep(Weakness.NAMES, plain, cost))
    return tuple(found)


def signing_issuers(session: Session) -> tuple[str, ...]:
    """Return the authorities that issue identities and sign documents."""
    signing = {name: {each.signs for each in of_name} for name, of_name in uses(session).items()}
    return tuple(sorted(name for name, signs in signing.items() if signs == {True, False}))


def lacks(session: Session) -> dict[str, list[Diagnostic]]:
    """Return what the certificates of authorities lack that they would have from Keymint, as warnings by authority."""
    found: dict[str, list[Diagnostic]] = {}
    for each in (read_files(session, authority) for authority in session.profile.authorities):
        if each.certificate is not None:
            found[each.name] = list(foreign_authorities.defects(each.certificate, each.name, each.certificate_file))
    return {name: warnings for name, warnings in found.items() if warnings}


def _is_unique(session: Session, name: str) -> bool:
    package = session.package(name)
    suffix = unique_suffix(package.subject, package.issuance.generation)
    return any(each.value == suffix for each in parse(package.identity.subject_name, package.identity.origin))
