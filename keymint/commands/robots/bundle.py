# SPDX-License-Identifier: Apache-2.0
"""``keymint bundle``: what a robot needs of its installed enclave, in one signed file; see :mod:`keymint.robots`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from cryptography import x509

from comarmor.values import Data, field, replace
from keymint.api import Package, Phase
from keymint.authority.authorities import MintedAuthority, plan_authorities
from keymint.authority.rollover import phase_of
from keymint.command_line.named_files import told_written, user_path, write_outputs
from keymint.command_line.options import Names, bundle_output_option, names_group
from keymint.command_line.verb import Report, Run, flag, verb
from keymint.errors import Diagnostic, KeymintError, Origin, Severity, require_none, usage_error
from keymint.examine.keystore import of_enclaves
from keymint.life.terms import iso_time
from keymint.life.workspace_register import complete_register, register_change, withdrawn
from keymint.names import subject_of
from keymint.output.report import members
from keymint.pki import certificates, revocation_lists
from keymint.robots import bundle as bundles
from keymint.robots.bundle import CERTIFICATE, KEY, Manifest
from keymint.robots.certification_request import CertificationRequest
from keymint.stages.identities import missing_enclave
from keymint.stages.install import is_current, would_stay
from keymint.stages.rollover_phases import require_staged, session_ahead
from keymint.store.changes import Plan
from keymint.workspace.installed_enclaves import INSTALLED, enclave_names
from keymint.workspace.package_build_types import build_types_of
from keymint.workspace.session import Session


@verb(dry_run=True)
def bundle(
    run: Run,
    names: Names = names_group("NAME", required=True),
    output: Path | None = bundle_output_option,
    staged: bool = flag(),
) -> Report:
    """Write installed enclaves into bundles, one for each, which robots take with 'keymint accept'.

    A bundle is signed by the authority of the enclave's certificate, and numbered, so that a robot refuses an older
    one. It contains the private key if this workspace made it; then keep the bundle as secret as the key. NAME is
    an installed package, and PATTERN matches the names of several: '/robot1/*'.

    Options:
        staged: Bundle enclaves of the second keystore, which 'keymint authority replace' staged; the robot accepts them
            into a copy of its keystore.
    """
    made: list[MadeBundle] = []

    def make_plan(session: Session) -> Plan:
        there = [name for name in enclave_names(session) if name in frozenset(session.packages())]
        chosen = dict.fromkeys(names.packages(run, session, matched=there))
        require_output(run, output, len(chosen))
        ahead, authorities = _second_keystore(run, session) if staged else (None, _in_force(session, chosen))
        plan, made[:] = plan_bundles(session, chosen, authorities, ahead)
        found = names.packages(run, session, matched=[*there, *withdrawn(session)]) if chosen else ()
        return plan.noting(*(_passed_over(run, session, output, name) for name in found if name not in chosen))

    report = run.change(make_plan)
    return replace(report, steps=(), result={"bundles": write_bundles(run, output, made)})


def _passed_over(run: Run, session: Session, output: Path | None, name: str) -> Diagnostic:
    """Return the warning on a revoked package that a pattern matches, and on the bundle of it that was made before."""
    message = f"{subject_of(name)} has no bundle: its certificate was revoked ({withdrawn(session)[name]})"
    help_, where = f"'keymint renew --rekey {name}' makes a new key and certificate", None
    target = _target(run, output, name)
    if target != output and user_path(run, target).exists():
        message, help_, where = f"{message}, so this one is out of date", f"delete it; {help_}", Origin(str(target))
    return Diagnostic.warning("identity-revoked", message, where, help_, subject_of(name))


def _target(run: Run, output: Path | None, name: str) -> Path:
    """Return the file of a package's bundle."""
    file = f"{name.replace('/', '.')}.bundle"
    return Path(file) if output is None else output / file if user_path(run, output).is_dir() else output


def _in_force(session: Session, names: Collection[str]) -> Mapping[str, MintedAuthority]:
    """Return the authorities, by which some enclaves are installed as the sources say.

    Raises:
        KeymintError: an enclave is not.
    """
    plan, authorities = plan_authorities(session)
    after = session.after(plan)
    for name in names:
        if name in withdrawn(session):
            raise KeymintError.of([replace(missing_enclave(session, session.package(name)), severity=Severity.ERROR)])
        if plan.writes() or not (is_current(after, name) or would_stay(after, name, authorities)):
            message = f"the enclave {subject_of(name)} is not installed as its sources and authorities are now"
            help_ = f"run 'keymint build {name}' and 'keymint install {name}' first"
            missing = missing_enclave(session, session.package(name))
            found = replace(missing, message=message, help=help_) if name in enclave_names(after) else missing
            raise KeymintError.of([replace(found, code="not-installed")])
    require_none(each for each in of_enclaves(after) if each.subject in set(map(subject_of, names)))
    return authorities


def _second_keystore(run: Run, session: Session) -> tuple[Session, Mapping[str, MintedAuthority]]:
    """Return the session and the authorities of the second keystore.

    Raises:
        KeymintError: there is none, or it is not complete.
    """
    replaced = [each.name for each in session.profile.authorities if phase_of(session, each.name) is Phase.STAGE]
    if not replaced:
        message = "there is no second keystore: no authority is replaced that way"
        raise KeymintError(message, where=session.profile_marker(), help="leave --staged out", code="rollover-none")
    require_staged(run.crew, session, replaced[0])
    return session_ahead(session, replaced[0])


def require_output(run: Run, output: Path | None, number: int) -> None:
    """Require that several bundles go to a folder.

    Raises:
        KeymintError: they do not; a usage error.
    """
    if number > 1 and output is not None and not user_path(run, output).is_dir():
        raise usage_error(f"{output} is no folder, and there are {number} bundles", "make the folder, or name another")


def write_bundles(run: Run, output: Path | None, made: Sequence[MadeBundle]) -> list[dict[str, Any]]:
    """Write bundles, each complete or not at all, and say what they are.

    Returns:
        Each bundle for ``--json``.

    Raises:
        KeymintError: the system refuses.
    """
    documents = []
    told: list[str] = []
    for each in made:
        target = _target(run, output, each.manifest.name)
        told += told_written(run, target, write_outputs(run, target, each.content, secret=each.secret))
        if each.secret:
            told.append(
                f"  it has the private key of {each.manifest.enclave}: whoever reads it can act as this enclave"
            )
        documents.append(
            {
                "enclave": each.manifest.enclave,
                "file": str(target),
                "has_private_key": each.secret,
                **members(each.manifest, "key", "authority", "generation", "issue", "revocations", "not_after"),
            }
        )
    run.console.messages(told)
    run.console.lines(
        f"on a robot that has nothing of this authority yet: keymint accept --authority-fingerprint {authority}"
        for authority in dict.fromkeys(each.manifest.authority for each in made)
    )
    return documents


# -- making them -------------------------------------------------------------------------------------------------


class MadeBundle(Data):
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
    require_none(dict.fromkeys(errors))
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
        raise KeymintError.of([replace(missing_enclave(session, package), code="not-installed")])
    issuer = authorities[package.identity.issuer].issuer
    certificate = certificates.load(files[CERTIFICATE], session.workspace.origin(folder / CERTIFICATE))
    first, last = _period(package, certificate, files)
    if last < session.now:
        message = f"what the enclave {subject_of(name)} has is in force until {iso_time(last)} only"
        help_ = f"'keymint check {name}' says what ended; 'keymint renew' and 'keymint crl --refresh' issue it again"
        raise KeymintError(message, where=session.workspace.origin(folder), help=help_, code="bundle-dates")
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


def _period(package: Package, certificate: x509.Certificate, files: Mapping[str, bytes]) -> tuple[datetime, datetime]:
    """Return from when to when all that is in an enclave is in force: what ends first ends all of it."""
    # Software that reads one authority from a file reads the first one.
    authorities = [chain[0] for chain in bundles.certificates_of_authorities(files).values()]
    periods = [*map(certificates.period, (certificate, *authorities))]
    grant = package.grant.validity
    periods += [(grant.not_before, grant.not_after)] if grant else []
    periods += map(revocation_lists.period, bundles.revocation_lists(files))
    return max(first for first, _ in periods), min(last for _, last in periods)
