# SPDX-License-Identifier: Apache-2.0
"""May a robot take a bundle? Decided from what its keystore has, and from what its owner says.

The carrier of a bundle may be anybody. So nothing is taken on trust but what the keystore already trusts, or what the
owner gives by hand: authorities are known by their keys, an enclave by its own key, and no number ever goes back.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from comarmor.values import Data, field
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.pki import certificates, examine, keys, revocation_lists as crl
from keymint.robots.bundle import CERTIFICATE, KEY, Bundle, Manifest, load, number_of, revocation_lists
from keymint.robots.robot_keystore import Present

RECORD = "bundle.json"
"""The file of an enclave that has the manifest of the bundle it came from."""
_AUTHORITY = ".cert"
"""What the names of files with certificates have in common, beside that of the enclave's own."""


class Owner(Data):
    """What the owner of a robot says.

    Attributes:
        authorities: fingerprints of keys of authorities that he compared by hand.
        new: a new enclave is expected.
    """

    authorities: frozenset[str] = frozenset()
    new: bool = False


class Acceptance(Data):
    """What to do with the folder of an enclave.

    Attributes:
        files: its files that change, by name.
        removed: names of files that an earlier bundle brought and this one does not.
        answered: the request that waited is answered.
        notes: a warning for each file of the enclave that is part of no bundle, and that a transport may read.
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
            ``bundle-dates``, ``bundle-chain``, ``bundle-revoked``: nodes would not start with it, or
            an enclave here has a revocation list with its certificate.
    """
    was_accepted = bundle.encoded == present.files.get(RECORD)
    _require_known_authorities(bundle, present, owner.authorities, where, was_accepted=was_accepted)
    before = _accepted_last(present)
    if not was_accepted:
        _require_later(bundle, present, before, where)
    _require_expected(bundle.manifest, present, owner, before, where)
    key = _private_key(bundle, present, where)
    _require_in_force(bundle, now, where)
    by_signer = (each for each in present.lists if crl.is_by(each, bundle.signer))
    if any(each.get_revoked_certificate_by_serial_number(bundle.certificate.serial_number) for each in by_signer):
        message = "its certificate was revoked: a revocation list in this keystore has it"
        help_ = "ask the authority for a new bundle, if the enclave is still needed"
        raise KeymintError(message, where=where, help=help_, code="bundle-revoked")
    wanted = {**bundle.files, **({KEY: key} if key else {}), RECORD: bundle.encoded}
    files = {name: content for name, content in wanted.items() if present.files.get(name) != content}
    # A key of an earlier request is of no use beside a certificate for another one.
    brought = {*(before.files if before else ()), KEY}
    removed = tuple(sorted(name for name in present.files if name in brought and name not in wanted))
    # The certificate comes last: a node that starts in between fails, and admits nobody.
    ordered = dict(sorted(files.items(), key=lambda item: item[0] == CERTIFICATE))
    pending = present.pending
    answered = pending is not None and pending.request.fingerprint == bundle.manifest.key
    message, help_ = "was there before and is not part of the bundle", "remove it unless you know what reads it"
    left = (name for name in sorted(present.files.keys() - {*wanted, *removed}) if not name.startswith("."))
    notes = (Diagnostic.warning("bundle-left", message, Origin(f"{present.folder}/{name}"), help_) for name in left)
    return Acceptance(ordered, removed, answered, tuple(notes))


# -- who it is by ------------------------------------------------------------------------------------------------


def _require_known_authorities(
    bundle: Bundle, present: Present, given: frozenset[str], where: Origin, *, was_accepted: bool
) -> None:
    """Require that the authorities can be compared, and are those of the keystore, or given by hand.

    What the keystore knows by the name of a file stays: also the signer of the manifest may not exchange the
    authority for rights, and that one signs no manifest. A file that no enclave has yet is vouched for by the
    signer.
    """
    for name in bundle.files.keys() - bundle.authorities.keys() - {CERTIFICATE}:
        if _AUTHORITY in name:  # e.g. a reference to a token, which nodes would prefer
            message = f"its file {name} names an authority in a form that cannot be compared"
            help_ = "ask the authority for a bundle with certificates in PEM"
            raise KeymintError(message, where=where, help=help_, code="bundle-authority")
    signer = bundle.manifest.authority
    give = "('keymint authority show') and give it with --authority-fingerprint"
    trusted = was_accepted or signer in given
    for name, chain in bundle.authorities.items():
        known = present.known.get(name)
        if known is None:
            continue
        trusted = trusted or (name in present.issuing and bundle.signer in chain and signer in known)
        if any(certificates.fingerprint(each) not in known | given for each in chain):
            message = f"its file {name} has another authority than the enclaves in this keystore"
            help_ = f"if the authorities changed, ask their owner for the fingerprint {give}"
            raise KeymintError(message, where=where, help=help_, code="bundle-authority")
    if not trusted:
        nobody = "no enclave in this keystore trusts it" if present.known else "this keystore trusts no authority yet"
        # Its own fingerprint is not in the message: nobody should copy it from here.
        wrong = f"its fingerprint does not match {', '.join(sorted(given))}"
        message = f"its authority is not known here: {wrong if given else nobody}"
        help_ = f"ask its owner for the fingerprint of the key {give}"
        raise KeymintError(message, where=where, help=help_, code="bundle-authority")


# -- whom it is for ----------------------------------------------------------------------------------------------


def _accepted_last(present: Present) -> Manifest | None:
    """Return the manifest of the bundle that the enclave came from, or None."""
    encoded = present.files.get(RECORD)
    if encoded is None:
        return None
    where = Origin(f"{present.folder}/{RECORD}")
    try:
        return load(encoded, where)
    except KeymintError:
        message = "is not the manifest of the bundle that was accepted last, so its numbers are not known"
        help_ = "restore it; or remove it, and take only a bundle that you know to be the latest"
        raise KeymintError(message, where=where, help=help_, code="bundle-record") from None


def _require_expected(
    manifest: Manifest, present: Present, owner: Owner, before: Manifest | None, where: Origin
) -> None:
    """Require that the enclave is one of the keystore, and that the bundle answers none but its last request."""
    pending, is_new = present.pending, not present.files
    nonces = {pending.request.nonce} if pending else set[str]()
    nonces |= {before.nonce} if before else set()
    asks = pending is not None and is_new and pending.request.fingerprint == manifest.key
    if (manifest.nonce or asks) and manifest.nonce not in nonces:
        message = f"it does not answer the request that {manifest.enclave} of this keystore made last"
        help_ = "make a new request with 'keymint request', or take the answer to the last one"
        raise KeymintError(message, where=where, help=help_, code="bundle-nonce")
    if is_new and pending is None and not owner.new:
        message = f"it is for {manifest.enclave}, which this keystore does not have and did not request"
        help_ = "if it is for this robot, add --new"
        raise KeymintError(message, where=where, help=help_, code="bundle-unexpected")


def _private_key(bundle: Bundle, present: Present, where: Origin) -> bytes:
    """Return the private key of the enclave, PEM; empty if it is not in a file, but in a token."""
    wanted, brought = bundle.manifest.key, bundle.files.get(KEY, b"")
    here = (brought,) if brought else (present.pending.key if present.pending else b"", present.files.get(KEY, b""))
    for pem in filter(None, here):
        try:
            if keys.fingerprint(keys.public_of(pem)) == wanted:
                return pem
        except KeymintError as error:
            if error.diagnostics[0].code == "key-password":  # nobody here can tell which it is, so it may be this
                return pem
    if not brought and _is_elsewhere(present, wanted):
        return b""
    message = f"it certifies the key {wanted}, which {bundle.manifest.enclave} in this keystore does not have"
    help_ = "it may be for another robot; or make a new request with 'keymint request'"
    raise KeymintError(message, where=where, help=help_, code="bundle-key")


# -- when it is for ----------------------------------------------------------------------------------------------


def _require_in_force(bundle: Bundle, now: datetime, where: Origin) -> None:
    """Require that nodes start with it now: a list that has expired, e.g., keeps every node from starting."""
    first, last = bundle.manifest.not_before, bundle.manifest.not_after
    again = "ask the authority for a new bundle"
    if not first <= now <= last:
        message = f"it is in force from {_shown(first)} to {_shown(last)}; this machine's clock is at {_shown(now)}"
        raise KeymintError(message, where=where, help=f"set the clock, or {again}", code="bundle-dates")
    chain = next(bundle.files[name] for name, each in bundle.authorities.items() if bundle.signer in each)
    if problems := examine.verify_chain(bundle.files[CERTIFICATE], chain, now, where):
        message = f"its certificate is not valid: {problems[0].message}"
        raise KeymintError(message, where=where, help=again, code="bundle-chain")
    authorities = [each for of_file in bundle.authorities.values() for each in of_file]
    for listed in bundle.lists:
        by = [each for each in authorities if crl.is_by(listed, each)]
        begin, end = crl.period(listed)
        problem = "" if by and begin <= now <= end else "is not in force, or by another authority"
        serial = bundle.certificate.serial_number
        if by == [bundle.signer] and listed.get_revoked_certificate_by_serial_number(serial):
            problem = "revokes its own certificate"
        if problem:
            help_ = f"{again}; 'keymint crl --refresh' issues the list again"
            message = f"a revocation list of it {problem}: nodes would not start"
            raise KeymintError(message, where=where, help=help_, code="bundle-revoked")


def _require_later(bundle: Bundle, present: Present, before: Manifest | None, where: Origin) -> None:
    """Require that no number goes back. Without an earlier bundle, what is installed gives the numbers."""
    manifest = bundle.manifest
    back, ask = "", "ask the authority for a new one; 'keymint bundle' writes it"
    if number_of(bundle.lists, bundle.signer) != manifest.revocations:
        message = "its revocation list is another than its manifest says"
        raise KeymintError(message, where=where, help=ask, code="bundle-outdated")
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
        message = f"it is older than what {manifest.enclave} has: {back}"
        raise KeymintError(message, where=where, help=ask, code="bundle-outdated")


def _is_elsewhere(present: Present, wanted: str) -> bool:
    """Tell whether an enclave has a key without a file of it: the one that it asked for last, or that it had before."""
    if present.pending and not present.pending.key and present.pending.request.fingerprint == wanted:
        return True
    certificate = present.files.get(CERTIFICATE)
    if certificate is None or KEY in present.files:
        return False
    return certificates.fingerprint(certificates.load(certificate, Origin(f"{present.folder}/{CERTIFICATE}"))) == wanted


def _older_than_installed(bundle: Bundle, present: Present) -> str:
    """Return how a bundle is older than what is installed, which came from elsewhere; empty if it is not."""
    pem = present.files.get(CERTIFICATE)
    if pem is not None:
        begin = certificates.load(pem, Origin(f"{present.folder}/{CERTIFICATE}")).not_valid_before_utc
        if bundle.certificate.not_valid_before_utc < begin:
            return f"its certificate begins before {_shown(begin)}"
    try:
        number = number_of(revocation_lists(present.files), bundle.signer)
    except ValueError:
        number = 0  # what cannot be read keeps nodes from starting, so nothing rests on it
    return f"its revocation list is not the number {number}" if bundle.manifest.revocations < number else ""


def _shown(moment: datetime) -> str:
    return f"{moment:%Y-%m-%dT%H:%M:%SZ}"
