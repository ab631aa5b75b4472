# SPDX-License-Identifier: Apache-2.0
"""May a robot take a bundle? Decided from what its keystore has, and from what its owner says.

The carrier of a bundle may be anybody. So nothing is taken on trust but what the keystore already trusts, or what the
owner gives by hand: authorities are known by their keys, an enclave by its own key, and no number ever goes back.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import field
from datetime import datetime

from comarmor.errors import Diagnostic, Origin
from comarmor.values import dataclass
from keymint.errors import KeymintError
from keymint.pki import certificates, certification_path, keys
from keymint.pki import revocation_lists as crl
from keymint.robots.bundle import CERTIFICATE, KEY, Bundle, number_of, revocation_lists
from keymint.robots.bundle_manifest import Manifest, load
from keymint.robots.certification_request import Request

RECORD = "bundle.json"
"""The file of an enclave that has the manifest of the bundle it came from."""


_AUTHORITY = ".cert"
"""What the names of files with certificates have in common, beside that of the enclave's own."""


@dataclass(frozen=True, slots=True)
class Pending:
    """A request that waits for its answer: the request, and its private key (PEM) unless the enclave has it."""

    request: Request
    key: bytes = field(default=b"", repr=False)


@dataclass(frozen=True, slots=True)
class Present:
    """What a keystore has, as far as it matters to one enclave.

    Attributes:
        folder: the enclave's folder as the user would type it.
        files: the enclave's files by name; empty if the keystore does not have it.
        pending: its request that waits for an answer.
        known: fingerprints of the keys of authorities that some enclave of the keystore trusts, by name of their file.
        issuing: names of those files whose authorities issue certificates of enclaves.
    """

    folder: str
    files: Mapping[str, bytes] = field(repr=False)
    pending: Pending | None
    known: Mapping[str, frozenset[str]]
    issuing: frozenset[str]


@dataclass(frozen=True, slots=True)
class Owner:
    """What the owner of a robot says.

    Attributes:
        authorities: fingerprints of keys of authorities that he compared by hand.
        new: a new enclave is expected.
    """

    authorities: frozenset[str] = frozenset()
    new: bool = False


@dataclass(frozen=True, slots=True)
class Acceptance:
    """What to do with the folder of an enclave.

    Attributes:
        files: its files that change, by name.
        removed: names of files that an earlier bundle brought and this one does not.
        answered: the request that waited is answered.
        notes: warnings.
    """

    files: Mapping[str, bytes] = field(repr=False)
    removed: tuple[str, ...]
    answered: bool
    notes: tuple[Diagnostic, ...] = ()


def accept(bundle: Bundle, present: Present, owner: Owner, now: datetime, where: Origin) -> Acceptance:
    """Return what to do with an enclave.

    Args:
        bundle: the bundle.
        present: what the keystore has.
        owner: what the owner says.
        now: the clock, UTC.
        where: the file of the bundle, for messages.

    Raises:
        KeymintError: ``bundle-authority``: it rests on an authority that nobody knows here. ``bundle-unexpected``: it
            is for an enclave that nobody expects. ``bundle-nonce``: it answers another request.
            ``bundle-outdated``: a number would go back. ``bundle-key``: the keystore does not have its key.
            ``bundle-dates``, ``bundle-chain``, ``bundle-revoked``: nodes would not start with it.
    """
    _require_known_authorities(bundle, present, owner, where)
    before = _manifest(present)
    _require_later(bundle, present, before, where)
    _require_expected(bundle, present, before, owner, where)
    key = _private_key(bundle, present, where)
    _require_in_force(bundle, now, where)
    wanted = {**bundle.files, **({KEY: key} if key else {}), RECORD: bundle.encoded}
    files = {name: content for name, content in wanted.items() if present.files.get(name) != content}
    # A key of an earlier request is of no use beside a certificate for another one.
    brought = {*(before.files if before else ()), KEY}
    removed = tuple(sorted(name for name in present.files if name in brought and name not in wanted))
    # The certificate comes last: a node that starts in between fails, and admits nobody.
    ordered = dict(sorted(files.items(), key=lambda item: item[0] == CERTIFICATE))
    pending = present.pending
    answered = pending is not None and pending.request.fingerprint == bundle.manifest.key
    notes = tuple(_left(present, {*wanted, *removed}))
    return Acceptance(ordered, removed, answered, notes)


# -- who it is by ----------------------------------------------------------------------------------------------------


def _require_known_authorities(bundle: Bundle, present: Present, owner: Owner, where: Origin) -> None:
    """Require that the authorities are those of the keystore, or given by hand.

    What the keystore knows by the name of a file stays: also the signer of the manifest may not exchange the authority
    for rights, and that one signs no manifest. A file that no enclave has yet is vouched for by the signer.
    """
    for name in bundle.files.keys() - bundle.authorities.keys() - {CERTIFICATE}:
        if _AUTHORITY in name:  # e.g. a reference to a token, which nodes would prefer
            raise KeymintError(
                f"its file {name} names an authority in a form that cannot be compared",
                where=where,
                help="ask the authority for a bundle with certificates in PEM",
                code="bundle-authority",
            )
    was_accepted = bundle.encoded == present.files.get(RECORD)
    trusted = was_accepted or bundle.manifest.authority in owner.authorities
    for name, chain in bundle.authorities.items():
        known = present.known.get(name)
        if known is None:
            continue
        issues = name in present.issuing and bundle.signer in chain
        trusted = trusted or (issues and bundle.manifest.authority in known)
        if any(certificates.fingerprint(each) not in known | owner.authorities for each in chain):
            raise KeymintError(
                f"its file {name} has another authority than the enclaves in this keystore",
                where=where,
                help="if the authorities changed, ask their owner for the fingerprint ('keymint authority show') and "
                "give it with --authority-fingerprint",
                code="bundle-authority",
            )
    if not trusted:
        nobody = "this keystore trusts no authority yet" if not present.known else "no enclave in this keystore does"
        raise KeymintError(
            f"it is by an authority whom nobody vouches for: {nobody}",
            where=where,
            help="ask its owner for the fingerprint of the key ('keymint authority show') and give it with "
            "--authority-fingerprint",
            code="bundle-authority",
        )


# -- whom it is for --------------------------------------------------------------------------------------------------


def _manifest(present: Present) -> Manifest | None:
    """Return the manifest of the bundle that the enclave came from, or None."""
    encoded = present.files.get(RECORD)
    if encoded is None:
        return None
    where = Origin(f"{present.folder}/{RECORD}")
    try:
        return load(encoded, where)
    except KeymintError:
        raise KeymintError(
            "is not the manifest of the bundle that was accepted last, so its numbers are not known",
            where=where,
            help="restore it; or remove it, and take only a bundle that you know to be the latest",
            code="bundle-record",
        ) from None


def _require_expected(bundle: Bundle, present: Present, before: Manifest | None, owner: Owner, where: Origin) -> None:
    """Require that the enclave is one of the keystore, and that the bundle answers no other request than its own."""
    manifest, pending = bundle.manifest, present.pending
    nonces = {pending.request.nonce} if pending else set[str]()
    nonces |= {before.nonce} if before else set()
    asks = pending is not None and not present.files and pending.request.fingerprint == manifest.key
    if (manifest.nonce or asks) and manifest.nonce not in nonces:
        raise KeymintError(
            f"it does not answer the request that {manifest.enclave} of this keystore made last",
            where=where,
            help="make a new request with 'keymint request', or take the answer to the last one",
            code="bundle-nonce",
        )
    if not present.files and pending is None and not owner.new:
        raise KeymintError(
            f"it is for {manifest.enclave}, which this keystore does not have and did not request",
            where=where,
            help="if it is for this robot, say --new",
            code="bundle-unexpected",
        )


def _private_key(bundle: Bundle, present: Present, where: Origin) -> bytes:
    """Return the private key of the enclave, PEM; empty if it is not in a file, but in a token.

    Raises:
        KeymintError: the keystore does not have the key.
    """
    wanted = bundle.manifest.key
    brought = bundle.files.get(KEY, b"")
    pending = present.pending
    here = (brought,) if brought else (pending.key if pending else b"", present.files.get(KEY, b""))
    for pem in filter(None, here):
        if _is_key(pem, wanted):
            return pem
    if not brought and _is_elsewhere(present, wanted):
        return b""
    raise KeymintError(
        f"it certifies the key {wanted}, which {bundle.manifest.enclave} in this keystore does not have",
        where=where,
        help="it may be for another robot; or make a new request with 'keymint request'",
        code="bundle-key",
    )


def _is_elsewhere(present: Present, wanted: str) -> bool:
    """Tell whether an enclave has a key without a file of it: the one that it asked for last, or that it had before."""
    if present.pending and not present.pending.key and present.pending.request.fingerprint == wanted:
        return True
    certificate = present.files.get(CERTIFICATE)
    if certificate is None or KEY in present.files:
        return False
    return certificates.fingerprint(certificates.load(certificate, Origin(f"{present.folder}/{CERTIFICATE}"))) == wanted


def _is_key(pem: bytes, wanted: str) -> bool:
    """Tell whether a private key has a fingerprint; of an encrypted one nobody here can tell, so it may."""
    try:
        return keys.fingerprint(keys.public_of(pem)) == wanted
    except KeymintError as error:
        return error.diagnostics[0].code == "key-password"


# -- when it is for --------------------------------------------------------------------------------------------------


def _require_in_force(bundle: Bundle, now: datetime, where: Origin) -> None:
    """Require that nodes start with a bundle now: a list that has expired, e.g., keeps every node from starting."""
    manifest = bundle.manifest
    if not manifest.not_before <= now <= manifest.not_after:
        raise KeymintError(
            f"it is in force from {manifest.not_before:%Y-%m-%dT%H:%M:%SZ} to {manifest.not_after:%Y-%m-%dT%H:%M:%SZ}, "
            f"and the clock of this machine is at {now:%Y-%m-%dT%H:%M:%SZ}",
            where=where,
            help="set the clock, or ask the authority for a new bundle",
            code="bundle-dates",
        )
    chain = next(bundle.files[name] for name, each in bundle.authorities.items() if bundle.signer in each)
    problems = certification_path.verify_chain(bundle.files[CERTIFICATE], chain, now, where)
    if problems:
        raise KeymintError(
            f"its certificate is not valid: {problems[0].message}",
            where=where,
            help="ask the authority for a new bundle",
            code="bundle-chain",
        )
    authorities = [each for of_file in bundle.authorities.values() for each in of_file]
    for listed in bundle.lists:
        by = [each for each in authorities if crl.is_by(listed, each)]
        begin, end = crl.period(listed)
        problem = "" if by and begin <= now <= end else "is not in force, or by another authority"
        if by == [bundle.signer] and listed.get_revoked_certificate_by_serial_number(bundle.certificate.serial_number):
            problem = "revokes its own certificate"
        if problem:
            raise KeymintError(
                f"a revocation list of it {problem}: nodes would not start",
                where=where,
                help="ask the authority for a new bundle; 'keymint crl --refresh' issues the list again",
                code="bundle-revoked",
            )


def _require_later(bundle: Bundle, present: Present, before: Manifest | None, where: Origin) -> None:
    """Require that no number goes back. Without a record of an earlier bundle, what is installed gives the numbers."""
    manifest = bundle.manifest
    if bundle.encoded == present.files.get(RECORD):
        return
    back = ""
    if number_of(bundle.lists, bundle.signer) != manifest.revocations:
        raise _outdated("its revocation list is another than its manifest says", where)
    if before is not None:
        same = before.authority == manifest.authority
        if manifest.issue <= before.issue:
            back = f"its issue number is {manifest.issue}, and {before.issue} was accepted"
        elif manifest.generation < before.generation:
            back = f"its generation is {manifest.generation}, and {before.generation} was accepted"
        elif same and manifest.revocations < before.revocations:
            back = f"its revocation list has the number {manifest.revocations}, and {before.revocations} was accepted"
    elif present.files:
        back = _older_than_installed(bundle, present)
    if back:
        raise _outdated(f"it is older than what {manifest.enclave} has: {back}", where)


def _older_than_installed(bundle: Bundle, present: Present) -> str:
    """Return how a bundle is older than what is installed, which came from elsewhere; empty if it is not."""
    pem = present.files.get(CERTIFICATE)
    if pem is not None:
        begin = certificates.load(pem, Origin(f"{present.folder}/{CERTIFICATE}")).not_valid_before_utc
        if bundle.certificate.not_valid_before_utc < begin:
            return f"its certificate begins before {begin:%Y-%m-%dT%H:%M:%SZ}"
    try:
        number = number_of(revocation_lists(present.files), bundle.signer)
    except ValueError:
        number = 0  # what cannot be read keeps nodes from starting, so nothing rests on it
    return f"its revocation list is not the number {number}" if bundle.manifest.revocations < number else ""


def _outdated(message: str, where: Origin) -> KeymintError:
    help_ = "ask the authority for a new one; 'keymint bundle' writes it"
    return KeymintError(message, where=where, help=help_, code="bundle-outdated")


def _left(present: Present, accounted: Collection[str]) -> Iterator[Diagnostic]:
    """Yield a warning for each file of the enclave that is part of no bundle, and that a transport may read."""
    for name in sorted(present.files.keys() - accounted):
        if not name.startswith("."):
            yield Diagnostic.warning(
                "bundle-left",
                "was there before and is not part of the bundle",
                Origin(f"{present.folder}/{name}"),
                "remove it unless you know what reads it",
            )
