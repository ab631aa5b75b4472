# SPDX-License-Identifier: Apache-2.0
"""Make bundles of installed enclaves; see :mod:`keymint.robots`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from datetime import datetime

from cryptography import x509

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.api import Package
from keymint.authority.authorities import MintedAuthority
from keymint.errors import KeymintError
from keymint.life.terms import iso_time
from keymint.life.workspace_register import complete_register, register_change
from keymint.names import subject_of
from keymint.pki import certificates, revocation_lists
from keymint.robots import bundle as bundles
from keymint.robots.bundle import CERTIFICATE, KEY, Manifest
from keymint.robots.certification_request import CertificationRequest
from keymint.store.changes import Plan
from keymint.workspace.installed_enclaves import INSTALLED
from keymint.workspace.package_build_types import build_types_of
from keymint.workspace.session import Session


@dataclass(frozen=True, slots=True)
class MadeBundle:
    """A bundle, its manifest, and whether it has the private key of its enclave."""

    manifest: Manifest
    content: bytes = field(repr=False)
    secret: bool


def plan_bundles(
    session: Session,
    names: Mapping[str, CertificationRequest | None],
    authorities: Mapping[str, MintedAuthority],
    source: Session | None = None,
) -> tuple[Plan, tuple[MadeBundle, ...]]:
    """Plan bundles of enclaves, as they are installed.

    Each gets an issue number of its own, which the register has before a bundle leaves.

    Args:
        session: the workspace and its profile, with what is planned.
        names: the packages, each with the request that its bundle answers; None if it answers none.
        authorities: the authorities by name.
        source: the session whose keystore has the enclaves, if it is another one than the keystore in force.

    Returns:
        The plan for the register, and the bundles.

    Raises:
        KeymintError: an enclave is not installed, its authority's key is not here, or the authority may not sign
            documents.
    """
    register = complete_register(session)
    made: list[MadeBundle] = []
    errors: list[Diagnostic] = []
    for name, request in names.items():
        register = register.with_bundle(name, session.now)
        try:
            files = _staged_files(source, name) if source else _installed_files(session, name)
            made.append(_bundle(source or session, name, request, files, register.bundles[name], authorities))
        except KeymintError as error:
            errors += [replace(each, subject=each.subject or subject_of(name)) for each in error.diagnostics]
    if errors:
        raise KeymintError.of(dict.fromkeys(errors))
    return Plan((), session.state, first=register_change(session, register)), tuple(made)


def _installed_files(session: Session, name: str) -> Iterable[str]:
    """Return the names of the files that were installed into an enclave."""
    stamp = session.state.stamp(INSTALLED, name)
    return stamp.outputs if stamp else ()


def _staged_files(session: Session, name: str) -> Iterable[str]:
    """Return the names of the files that an enclave may have, of a keystore that the workspace has no record of."""
    build_types = build_types_of(session, session.package(name)).values()
    return {file for each in build_types for file in each.files(session.profile.layout)}


def _bundle(
    session: Session,
    name: str,
    request: CertificationRequest | None,
    names: Iterable[str],
    number: int,
    authorities: Mapping[str, MintedAuthority],
) -> MadeBundle:
    package, folder = session.package(name), session.enclave(name)
    contents = {file: session.tree.read(folder / file) for file in names}
    # The robot has the key that it asks a certificate for.
    files = {file: data for file, data in contents.items() if data is not None and not (request and file == KEY)}
    if CERTIFICATE not in files:
        raise KeymintError(
            f"the enclave {subject_of(name)} is not installed",
            where=session.workspace.origin(folder),
            help=f"run 'keymint install {name}'",
            code="not-installed",
        )
    issuer = authorities[package.identity.issuer].issuer
    certificate = certificates.load(files[CERTIFICATE], session.workspace.origin(folder / CERTIFICATE))
    first, last = _in_force(package, certificate, files)
    if last < session.now:
        raise KeymintError(
            f"what the enclave {subject_of(name)} has is in force until {iso_time(last)} only",
            where=session.workspace.origin(folder),
            help=f"'keymint check {name}' says what ended; 'keymint renew' and 'keymint crl --refresh' issue it again",
            code="bundle-dates",
        )
    manifest = Manifest(
        enclave=package.subject,
        folder=session.layouts[0].enclaves,
        key=certificates.fingerprint(certificate),
        authority=certificates.fingerprint(issuer.certificate),
        generation=package.issuance.generation,
        issue=number,
        revocations=bundles.number_of(bundles.revocation_lists(files), issuer.certificate),
        nonce=request.nonce if request else "",
        not_before=first,
        not_after=last,
        files={},
    )
    content = bundles.write(manifest, files, issuer)
    try:
        bundles.read(content, session.workspace.origin(folder))
    except KeymintError as error:  # e.g. the enclave was installed with an authority that was replaced since
        raise KeymintError(
            f"no robot would take a bundle of {subject_of(name)}: {error.diagnostics[0].message}",
            where=error.diagnostics[0].where,
            help=f"run 'keymint install {name}', which issues its certificate by the authority in force",
            code="bundle-unusable",
        ) from None
    return MadeBundle(manifest, content, KEY in files)


def _in_force(package: Package, certificate: x509.Certificate, files: Mapping[str, bytes]) -> tuple[datetime, datetime]:
    """Return from when to when all that is in an enclave is in force: what ends first ends all of it."""
    # Software that reads one authority from a file reads the first one.
    authorities = [chain[0] for chain in bundles.certificates_of_authorities(files).values()]
    periods = [*map(certificates.period, (certificate, *authorities))]
    grant = package.grant.validity
    periods += [(grant.not_before, grant.not_after)] if grant else []
    periods += map(revocation_lists.period, bundles.revocation_lists(files))
    return max(first for first, _ in periods), min(last for _, last in periods)
