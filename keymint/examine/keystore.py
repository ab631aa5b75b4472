# SPDX-License-Identifier: Apache-2.0
"""Ask what ``check`` and ``prove`` share about a keystore, and about a second one that lies beside it.

The claims about enclaves are one part of it, what was issued is the other one: certificates as the register has them,
and revocation lists with all that was revoked. An installed certificate is registered, not revoked, and has the dates
of its sources. Each enclave has the list in force, which has all revocations and revokes nobody else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

from cryptography import x509

from comarmor.text import first_few, hexadecimal, lazy_regex, quantity
from comarmor.values import replace
from keymint.api import LoadedPolicy, Phase
from keymint.authority.authority_files import issuers
from keymint.authority.rollover import staged_session
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.examine.rights import presented_rights
from keymint.host.pool import Pool
from keymint.life.examine import RIGHTS_OUTLIVE
from keymint.life.revocation_lists_in_force import enclave_lists
from keymint.life.terms import iso_time
from keymint.life.workspace_register import complete_register, issuer_of, register_of
from keymint.names import subject_of
from keymint.pki import certificate_forms, certificates, revocation_lists
from keymint.stages.proof_results import EnclaveProof, ProofEffort, ProofResults
from keymint.stages.prove import proofs
from keymint.store import journal
from keymint.workspace import installed_enclaves
from keymint.workspace.installed_enclaves import CERTIFICATE, INSTALLED, installed_certificate, with_sources
from keymint.workspace.package_build_types import build_types_of, is_build_current, revocation_files
from keymint.workspace.session import Inputs, Session, once

REGISTER_IS_OLDER = "revocation-list-living"
"""Code of the finding that a list has a revocation which the register lacks."""
_INSTALL_LIST = "'keymint install' writes it again; then deploy and restart the enclaves"


def issued_here(session: Session) -> Iterator[tuple[str, x509.Certificate, x509.Certificate]]:
    """Yield the packages with the certificate of their enclave and its issuer; others are reported with the chain."""
    authorities = [issuer for _, _, issuer in issuers(session)]
    for name in with_sources(session):
        certificate = installed_certificate(session, name)
        issuer = next((each for each in authorities if certificate and certificate.issuer == each.subject), None)
        if certificate and issuer:
            yield name, certificate, issuer


def _without_register(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding if revocations are not known without the register; else a note if anything was issued."""
    try:
        if complete_register(session).certificates:
            where, help_ = session.workspace.origin(session.workspace.register), "restore it from a backup"
            yield Diagnostic.note("register-lost", f"is missing: {_REGISTER}", where, help_)
    except KeymintError as error:
        yield from error.diagnostics


def register_findings(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding for each installed certificate of our authorities that is not as it was issued.

    Without a register nothing is known of what was issued: a finding if something was revoked, unless private files are
    left out.

    Raises:
        KeymintError: the register or a package has defects.
    """
    if session.tree.read(session.workspace.register) is None:
        yield from () if session.tree.is_left_out(session.workspace.register) else _without_register(session)
        return
    register = register_of(session)
    for name, certificate, issuer in issued_here(session):
        known = register.certificates.get((issuer_of(issuer), certificate.serial_number))
        package = session.package(name, built=is_build_current(session, name))
        where = session.workspace.origin(f"{session.enclave_folder(name)}/{CERTIFICATE}")
        issue = f"'keymint install {name}' issues another one"
        first, last = certificates.period(certificate)
        if known is None and not certificates.is_issued_by(certificate, issuer):
            continue  # its signature is reported with the chain: another key than our authority's made it
        if known is None:
            serial = hexadecimal(certificate.serial_number)
            message = f"is a certificate with the serial number {serial} that nobody registered"
            help_ = f"find out who issued it: the key of {package.identity.issuer!r} did; then {issue}"
            yield Diagnostic.error("certificate-unregistered", message, where, help_, package.subject)
        elif (known.name, known.key, known.not_before, known.not_after) != (
            name, certificates.fingerprint(certificate), first, last,
        ):  # fmt: skip
            message = f"differs from the certificate that was issued with the serial number {hexadecimal(known.serial)}"
            yield Diagnostic.error("certificate-unregistered", message, where, issue, package.subject)
        elif known.revoked is not None:
            message = f"was revoked on {iso_time(known.revoked)} ({known.reason})"
            help_ = f"remove the enclave; 'keymint renew --rekey {name}' makes a new key and certificate"
            yield Diagnostic.error("certificate-revoked", message, where, help_, package.subject)
        else:
            # One that another tool issued is kept with its dates, also beyond those of its issuer.
            kept = package.issuance.certificate
            adopted = bool(kept) and certificates.certificate_in(kept) == certificate
            wanted = certificate_forms.validity_within(package.identity.validity, None if adopted else issuer)
            if (first, last) != (wanted.not_before, wanted.not_after):
                text = f"is in force from {iso_time(first)} to {iso_time(last)}, which is not what the sources ask for"
                yield Diagnostic.warning("certificate-drift", text, where, issue, package.subject)


# -- revocation lists -----------------------------------------------------------------------------------------------


def lists_in_force(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding for each authority whose list lacks a revocation of the register, or revokes what is in force."""
    register = register_of(session)
    for name, _, issuer in issuers(session):  # others are reported with the authorities
        path = session.workspace.revocation_list(name)
        where = session.workspace.origin(path)
        revoked = {each.serial: each.name for each in register.revoked(issuer_of(issuer))}
        content = session.tree.read(path)
        try:
            listed = () if content is None else revocation_lists.load(content, where).revocations
        except KeymintError as error:
            yield from error.diagnostics
            continue
        if lacking := revoked.keys() - {each.serial for each in listed}:
            what = "is missing" if content is None else "is not the latest revocation list"
            message = f"{what}: {quantity(len(lacking), 'revoked certificate')} would be accepted"
            yield Diagnostic.error("revocation-list-outdated", message, where, _INSTALL_LIST)
        if content is not None and not revocation_lists.problem(content, issuer):
            yield from _living(session, content, where)


def of_enclaves(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding for each installed enclave with another revocation list than the one in force.

    Raises:
        KeymintError: a package has defects.
    """
    in_force = enclave_lists(session)
    for name in with_sources(session):
        package = session.package(name, built=is_build_current(session, name))
        files = installed_enclaves.enclave_files(session, name)[0]
        build_types, layout = build_types_of(session, package).values(), session.profile.layout
        expected = in_force.get(package.identity.issuer, b"")
        folder = session.workspace.shown(session.enclave_folder(name))
        for file, artifact in revocation_files(build_types, package.distro, layout, expected or b"list"):
            where = Origin(f"{folder}/{file}")
            if expected and files.get(file) != artifact.content:
                what = "is not the revocation list in force" if file in files else "the revocation list is missing"
                thieves = _accepted(session, package.identity.issuer)
                whom = f"the revoked {first_few(thieves)}" if thieves else "revoked certificates"
                message = f"{what}: {package.subject} accepts {whom}"
                help_ = f"'keymint install {name}' writes it; then deploy and restart the enclave"
                yield Diagnostic.error("revocation-list-outdated", message, where, help_, package.subject)
            if file in files and files[file] != expected:
                yield from _living(session, files[file], where, package.subject)


def _living(session: Session, pem: bytes, where: Origin, subject: str = "") -> Iterator[Diagnostic]:
    """Yield a finding if a list by an authority of the workspace revokes a certificate that is in force."""
    crl = revocation_lists.first(pem)
    found = [issuer for _, _, issuer in issuers(session) if crl is not None and revocation_lists.is_by(crl, issuer)]
    if crl is None or not found:
        return  # of a foreign one the checks of credentials tell
    serials = {entry.serial_number for entry in crl}
    names = sorted(
        {name for issuer, serial, name in _in_force(session) if issuer == issuer_of(found[0]) and serial in serials}
    )
    if names:
        message = f"revokes the certificate of {first_few(names)}, which the register does not have as revoked"
        help_ = f"'keymint revoke' revokes it; else remove this list, and {_INSTALL_LIST}"
        yield Diagnostic.error("revocation-list-living", message, where, help_, subject)


@once
def _in_force(session: Session) -> frozenset[tuple[str, int, str]]:
    """Return issuer, serial number and subject of each certificate that is not revoked: registered, or installed."""
    register = register_of(session)
    known = {
        (each.issuer, each.serial, subject_of(each.name))
        for each in register.certificates.values()
        if each.revoked is None and each.not_after >= session.now
    }
    for name, certificate, issuer in issued_here(session):
        key = issuer_of(issuer), certificate.serial_number
        if not register.is_revoked(*key):
            known.add((*key, subject_of(name)))
    return frozenset(known)


@once
def _accepted(session: Session, authority: str) -> tuple[str, ...]:
    """Return the subjects whose certificates by an authority were revoked and have not ended, sorted."""
    own, register = (issuer for _, name, issuer in issuers(session) if name == authority), register_of(session)
    revoked = (each for issuer in own for each in register.revoked(issuer_of(issuer)) if each.not_after >= session.now)
    return tuple(
        sorted({subject_of(each.name) if each.name else f"certificate {hexadecimal(each.serial)}" for each in revoked})
    )


SHOWN_NOTES = frozenset(
    {RIGHTS_OUTLIVE, "authority-key-missing", "identity-revoked", "not-examined", "register-lost", "subjects-uncreated"}
)
"""Codes of notes that are shown in any case: an owner must know of them."""
_REGISTER = "which certificates were issued and revoked is not known"
_KEYS = "no private key here is compared with its certificate"
_ENCLAVES = "private keys of enclaves are not compared with their certificates"
UNKNOWN_HISTORY = "nothing wider was signed before the register began to keep signed documents"


def proven_keystore(
    session: Session,
    names: Sequence[str],
    policy: LoadedPolicy,
    effort: ProofEffort,
    on_enclave: Callable[[str], None],
    pool: Pool,
) -> ProofResults:
    """Prove the claims about the enclaves of some packages, and about all that their certificates may present.

    Args:
        session: the workspace and its profile.
        names: names of packages.
        policy: the policy that the enclaves are compared with.
        effort: what to claim, and limits of the search.
        on_enclave: called with each name after its proof.
        pool: where else to prove.

    Raises:
        KeymintError: a package has defects, or the pool is lost.
    """
    results = proofs(session, policy, effort, names, on_enclave, pool)
    presented = presented_rights(session, results.state, policy, effort)
    shared, enclaves = (*results.shared, *presented.shared), results.enclaves
    if (ahead := staged_keystore_session(session)) is not None:
        ready = tuple(name for name in with_sources(ahead) if name in names)
        second = proofs(ahead, policy, effort, ready, lambda _: None, pool)
        ours = partial(_proof_of_second, session)
        enclaves, shared = (*enclaves, *map(ours, second.enclaves)), (*shared, *map(ours, second.shared))
    outliving, is_whole = presented.outliving, presented.is_whole
    return replace(
        results, enclaves=enclaves, shared=shared, state=presented.state, outliving=outliving, is_whole=is_whole
    )


INSTALLS = lazy_regex(r"'keymint (?:install|provision)[^']*'")
"""A command, in the help of a finding, that writes the keystore in force."""


def of_second_keystore(session: Session, found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return findings on a second keystore, with the command that writes that one in place of 'keymint install'."""
    return tuple(replace(each, help=_staged_again(session, each.help)) for each in found)


def _staged_again(session: Session, help_: str) -> str:
    return INSTALLS.sub(f"'keymint authority replace {_staging(session)}'", help_)


def _proof_of_second(session: Session, proof: EnclaveProof) -> EnclaveProof:
    examples = [each.counterexample for each in proof.claims]
    helped = [each and replace(each, help=_staged_again(session, each.help)) for each in examples]
    claims = tuple(replace(each, counterexample=own) for each, own in zip(proof.claims, helped, strict=True))
    return replace(proof, claims=claims, diagnostics=of_second_keystore(session, proof.diagnostics))


UNFINISHED = "run-unfinished"


def deciding_findings(session: Session) -> Iterator[Diagnostic]:
    """Yield the findings that may change what a transport decides, beside claims and trust anchors.

    Raises:
        KeymintError: the register or a package has defects.
    """
    records = session.workspace.state
    unfinished = journal.load(session.tree.try_read(records / journal.MARK) or b"", records)
    if unfinished.exchanges or session.tree.remnants:
        message = "a run was interrupted: what it wrote may be incomplete"
        command = f"'{unfinished.command}'" if unfinished.command else "its command"
        help_ = f"repeat {command}; every verb that writes finishes what is visible, or drops it"
        yield Diagnostic.warning(UNFINISHED, message, session.workspace.origin(records), help_)
    yield from _not_staged(session)
    yield from lists_in_force(session)
    yield from of_enclaves(session)
    yield from register_findings(session)


def _not_staged(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding if a second keystore is staged, and an installed enclave is not in it."""
    if not (name := _staging(session)):
        return
    try:
        ahead = staged_keystore_session(session)
    except KeymintError:  # reported with the second keystore
        return
    if lacking := {*with_sources(session)}.difference(with_sources(ahead) if ahead else ()):
        message = f"lacks {first_few(sorted(map(subject_of, lacking)))}: after the switch they have no enclave"
        where = session.workspace.origin(session.workspace.next_install)
        help_ = f"'keymint authority replace {name}' completes it; copy it to all robots again"
        yield Diagnostic.error("rollover-incomplete", message, where, help_)


def _staging(session: Session) -> str:
    """Return the authority for which a second keystore is staged, or an empty text."""
    phases = ((each.name, each.issuance.rollover) for each in session.profile.authorities)
    return next((name for name, rollover in phases if rollover and rollover.phase is Phase.STAGE), "")


@once
def staged_keystore_session(session: Session) -> Session | None:
    """Return the session of the second keystore as if it were in force; None if there is none.

    Raises:
        KeymintError: the next key is damaged.
    """
    name = _staging(session)
    if not name or not session.tree.names(session.workspace.next_install):
        return None
    ahead = staged_session(session, name)
    return replace(ahead, state=ahead.state.updated(INSTALLED, {}, tuple(ahead.state.stamps.get(INSTALLED, ()))))


def not_examined(inputs: Inputs) -> Iterator[Diagnostic]:
    """Yield a note for each entry of the private space that was left out, or has something in it that was.

    For all keys of enclaves that were left out there is one.
    """
    private, register, install = inputs.workspace.private, inputs.workspace.register, str(inputs.workspace.install)
    reasons = {str(private): f"{_KEYS}, and {_REGISTER}", str(register): _REGISTER, install: _ENCLAVES}
    left_out = dict.fromkeys(
        install if each.startswith(f"{install}/") else "/".join(each.split("/")[: len(private.parts) + 1])
        for each in inputs.tree.left_out
    )
    left_out.pop(str(inputs.workspace.log), None)
    for path in left_out:
        message, where = f"not examined: {reasons.get(path, _KEYS)}", inputs.workspace.origin(path)
        yield Diagnostic.note("not-examined", message, where, "a user who may read it examines it as well")
