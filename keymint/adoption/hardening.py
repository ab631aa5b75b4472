# SPDX-License-Identifier: Apache-2.0
"""What a keystore of another tool lacks, and the steps that mend it: each is planned alone, since each has its cost."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.api import HardenedPackageType, HardenedProfileType, Validity
from keymint.authority.authority_files import read_files
from keymint.authority.authority_issuance import authority_named
from keymint.authority.authority_uses import uses
from keymint.errors import KeymintError
from keymint.pki import foreign_authorities
from keymint.pki.distinguished_names import parse, unique_suffix
from keymint.store.changes import Action, Plan, Step, changed_below
from keymint.workspace.session import Session

STAGE = "harden"


class Weakness(StrEnum):
    """What a step mends."""

    NAMES = "names"
    """Subject names have no RDN that is unique to the subject."""
    AUTHORITY = "authority"
    """One authority issues identities and signs documents."""
    IDENTIFIERS = "identifiers"
    """The certificate of an authority lacks its key identifier or the permission to sign revocation lists."""


@dataclass(frozen=True, slots=True)
class OpenStep:
    """A step that is open.

    Attributes:
        step: what it mends.
        concerns: packages or authorities.
        flag_day: all enclaves change at one restart.
        cost: what it costs, in words.
    """

    step: Weakness
    concerns: tuple[str, ...]
    flag_day: bool
    cost: str


def open_steps(session: Session) -> tuple[OpenStep, ...]:
    """Return the steps that are open, in the order in which they cost least.

    Raises:
        KeymintError: a package has defects.
    """
    found = []
    if both := signing_issuers(session):
        cost = "a flag day: all documents are signed again, and all robots restart together with the new keystore"
        found.append(OpenStep(Weakness.AUTHORITY, both, flag_day=True, cost=cost))
    if lacking := tuple(lacks(session)):
        signs = {name for name in lacking if any(each.signs for each in uses(session).get(name, ()))}
        cost = "nothing restarts: robots with the old and with the new certificate of the authority work together"
        if signs:
            cost = f"a flag day, since {', '.join(sorted(signs))} signs documents: all robots restart together"
        if signs and both:
            cost += f"; none after '{Weakness.AUTHORITY}'"
        found.append(OpenStep(Weakness.IDENTIFIERS, lacking, flag_day=bool(signs), cost=cost))
    if plain := tuple(name for name in session.packages() if not _is_unique(session, name)):
        cost = "each enclave gets a new certificate and new permissions: copy it, and restart its nodes; others go on"
        found.append(OpenStep(Weakness.NAMES, plain, flag_day=False, cost=cost))
    return tuple(found)


def signing_issuers(session: Session) -> tuple[str, ...]:
    """Return the authorities that issue identities and sign documents."""
    found = uses(session)
    return tuple(
        name
        for name, of_name in sorted(found.items())
        if any(each.signs for each in of_name) and any(not each.signs for each in of_name)
    )


def lacks(session: Session) -> dict[str, list[Diagnostic]]:
    """Return what the certificates of authorities lack that they would have from Keymint, as warnings by authority."""
    files = [read_files(session, authority) for authority in session.profile.authorities]
    found = {
        each.authority.name: list(
            foreign_authorities.lacking(each.certificate, each.authority.name, each.certificate_file)
        )
        for each in files
        if each.certificate is not None
    }
    return {name: warnings for name, warnings in found.items() if warnings}


def _is_unique(session: Session, name: str) -> bool:
    package = session.package(name)
    suffix = unique_suffix(package.subject, package.issuance.generation)
    return any(each.value == suffix for each in parse(package.identity.subject_name, package.identity.origin))


def plan_names(session: Session, names: Sequence[str]) -> Plan:
    """Plan a unique RDN in the subject names of some packages; their sources change only.

    Raises:
        KeymintError: the sources are written in another way than Keymint writes them.
    """
    package_type = session.package_type
    if not isinstance(package_type, HardenedPackageType):
        raise _unsupported(session, f"packages of the type {session.profile.package_type!r}")
    steps = []
    for name in names:
        new = package_type.with_unique_name(session.profile, name, session.package_files(name))
        changes = changed_below(session.tree, session.workspace.src / name, new)
        steps.append(Step(STAGE, name, Action.UPDATED if changes else Action.UNCHANGED, changes, "unique subject name"))
    return Plan(tuple(steps), session.state)


def plan_authority(session: Session, former: str) -> Plan:
    """Plan another authority for the signature of documents, which outlives them; the profile changes only.

    Raises:
        KeymintError: the profile is written in another way than Keymint writes it, or has such an authority.
    """
    profile = session.profile
    profile_type: object = session.profile_type
    if not isinstance(profile_type, HardenedProfileType):
        raise _unsupported(session, f"profiles of the type {profile.profile_type!r}")
    name = profile_type.SIGNER
    if name in {each.name for each in profile.authorities}:
        raise KeymintError(
            f"the profile has an authority {name!r} already", where=session.profile_marker(),
            help="rename that authority, or name it as the signer in package.defaults/", code="authority-exists",
        )  # fmt: skip

    def plan(validity: Validity | None) -> Plan:
        edited = profile_type.with_own_signer(profile, former, validity)
        changes = changed_below(session.tree, session.workspace.profile, edited)
        return Plan((Step(STAGE, "", Action.UPDATED, changes, f"{name} signs in place of {former}"),), session.state)

    of_defaults = authority_named(session.after(plan(None)).session(), name).certificate.validity
    grants = [session.package(each).grant for each in session.packages()]
    ends = [each.validity.not_after for each in grants if each.validity and each.issuer == former]
    end = max(ends, default=of_defaults.not_after)
    return plan(Validity(of_defaults.not_before, end) if end > of_defaults.not_after else None)


def _unsupported(session: Session, what: str) -> KeymintError:
    return KeymintError(
        f"{what} cannot be changed by Keymint", where=session.profile_marker(), help="change them by hand",
        code="harden-unsupported",
    )  # fmt: skip
