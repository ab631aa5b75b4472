# SPDX-License-Identifier: Apache-2.0
"""Replace the key of an authority in phases, of which each is complete before the next begins.

How far it has come stands in the profile (:class:`keymint.api.Rollover`), with the certificate not in force. The
private key that is not in force lies beside the other one, as ``NAME.next.key.pem`` or ``NAME.former.key.pem``.

* bundle: ``distribute`` (enclaves trust both, the present one issues), ``reissue`` (the next one issues), and its end,
  after which they trust the next one alone;
* second keystore: ``stage`` (another keystore, by the next one, lies beside), and its end.

The authorities that are trusted beside those in force revoke what they issued, by lists of their own.
Each exchange of keys is one group of changes. A run that was killed within it is recognised by the key in force.
"""

from __future__ import annotations

from cryptography import x509

from comarmor.values import replace
from keymint.api import Authority, AuthorityIssuance, Phase, Rollover
from keymint.authority import authorities, authority_files, examine
from keymint.authority.authorities import STAGE, authority_named, plan_authorities, plan_authority_issuance
from keymint.authority.authority_changes import GivenAuthority, cert_and_key, issued_like, issuer_of
from keymint.authority.authority_files import FORMER, NEXT
from keymint.errors import KeymintError
from keymint.pki import certificates, extensions, keys, periods
from keymint.store.changes import Action, File, FolderChange, Plan, Step, secret_file
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import AUTHORITY_KEYS, password, with_recorded_keys


def phase_of(session: Session, name: str) -> Phase | None:
    """Return how far the replacement of an authority's key has come; None if none is under way."""
    rollover = authority_named(session, name).issuance.rollover
    return rollover.phase if rollover else None


def plan_begin(session: Session, name: str, phase: Phase, given: GivenAuthority | None) -> Plan:
    """Plan the next authority: its private key, and its certificate in the profile.

    Args:
        session: the workspace and its profile.
        name: the authority; no replacement of its key is under way.
        phase: :attr:`Phase.DISTRIBUTE` or :attr:`Phase.STAGE`.
        given: the next authority, if it was made elsewhere; by default one is made.

    Raises:
        KeymintError: the present authority cannot be told from a next one, or the given one is not suitable.
    """
    authority = authority_named(session, name)
    _require_free_names(session, name)
    if authority.certificate.key.uri:
        raise authorities.only_in_token(
            authority,
            "phases exchange keys in files. Make a new key in the token, name it in <pkcs11>, and run 'keymint install "
            f"--new-authority {name}': then all enclaves change at one restart",
        )
    present = plan_authorities(session)[1][name].certificate
    key_path = session.workspace.authority_key(f"{name}.{NEXT}")
    pem, key = _given(session, authority, given, present) if given else _made(session, authority)
    if phase is Phase.STAGE and given and not key:
        raise authority_files.key_elsewhere(f"{name}.{NEXT}", given.where, "give it with --key FILE")
    if phase is Phase.DISTRIBUTE:
        _require_distinct(session, name, present, certificates.load(pem))
    made: tuple[Step, ...] = ()
    if key and session.tree.read(key_path) != key:
        made = (Step(STAGE, name, Action.CREATED, (secret_file(key_path, key),), "next key"),)
    issuance = replace(authority.issuance, rollover=Rollover(phase, pem))
    decided = plan_authority_issuance(session, name, issuance, f"{name}: phase {phase}")
    return replace(decided, steps=(*made, *decided.steps))


def plan_switch(session: Session, name: str) -> Plan:
    """Plan that the next authority is in force: after :attr:`Phase.DISTRIBUTE` beside the former one, else alone.

    Raises:
        KeymintError: the next private key is neither here nor was it ever, or another one.
    """
    authority = authority_named(session, name)
    rollover = authority.issuance.rollover
    assert rollover is not None  # noqa: S101 - the caller asked for the phase
    following = certificates.load(rollover.certificate)
    names = name, f"{name}.{NEXT}", f"{name}.{FORMER}"
    key_path, next_path, former_path = map(session.workspace.authority_key, names)
    in_force, next_key = (authority_files.stored_key(session, authority, each) for each in names[:2])
    files: dict[str, File] = {}
    removed: tuple[str, ...] = ()
    if in_force is not None and not keys.matches(in_force[1], following):  # else a killed run kept the former key
        removed = (key_path.name,)  # if the next key is elsewhere, the present one must not stand in its place
        if rollover.phase is Phase.DISTRIBUTE:
            files[former_path.name] = File(in_force[0], secret=True)  # first: a killed run must not lose it
    if next_key is not None:
        where, help_ = session.workspace.origin(next_path), f"'keymint authority replace {name} --cancel'"
        of = f"the next certificate of {name!r}"
        examine.require_pair(next_key[1], following, where, of, f"restore it, or give up with {help_}")
        files[key_path.name] = File(next_key[0], secret=True)
        removed = (next_path.name,)
    issuance = _issuance_of(session, name, rollover.certificate)
    if rollover.phase is Phase.DISTRIBUTE:
        former = _former(session, authority, authority_files.stored_certificate(session, name), following)
        issuance = replace(issuance, rollover=Rollover(Phase.REISSUE, former))
    shown = f"{name}: {f'phase {Phase.REISSUE}' if issuance.rollover else 'replaced'}"
    decided = plan_authority_issuance(session, name, issuance, shown)
    public = session.workspace.authority_certificate(name)
    changes = (
        FolderChange(key_path.parent, files, removed, private=True),
        FolderChange(public.parent, {public.name: File(rollover.certificate)}),
    )
    exchanged = Step(STAGE, name, Action.UPDATED, tuple(each for each in changes if each.files or each.removed), "key")
    fingerprint = certificates.fingerprint(following)
    state = with_recorded_keys(session.state, AUTHORITY_KEYS, {name: fingerprint})
    return replace(decided, steps=(exchanged, *decided.steps), state=state)


def staged_session(session: Session, name: str) -> Session:
    """Return the session as it will be once the next authority is in force, with the second keystore as that one.

    Args:
        session: the workspace in the phase :attr:`Phase.STAGE`, and its profile.
        name: the authority.

    Raises:
        KeymintError: as :func:`plan_switch`.
    """
    workspace = session.workspace
    ahead = session.after(plan_switch(session, name)).session()
    ahead = replace(ahead, workspace=replace(workspace, install=workspace.next_install))
    present = session.tree.read(workspace.revocation_list(f"{name}.{NEXT}"))
    path = workspace.revocation_list(name)
    own = None if present is None else File(present)
    return replace(ahead, tree=ahead.tree.overlaid([(path.parent, {path.name: own})]))


def plan_end(session: Session, name: str) -> Plan:
    """Plan that enclaves no longer trust the former authority, whose private key is removed (:attr:`Phase.REISSUE`)."""
    issuance = replace(authority_named(session, name).issuance, rollover=None)
    decided = plan_authority_issuance(session, name, issuance, f"{name}: replaced")
    return replace(decided, steps=(*decided.steps, *without_keys(session, name, FORMER)))


def plan_cancel(session: Session, name: str) -> Plan:
    """Plan that the next authority is given up, which is not in force yet; its private key is removed.

    Raises:
        KeymintError: it is in force.
    """
    authority = authority_named(session, name)
    rollover = authority.issuance.rollover
    if rollover and (rollover.phase is Phase.REISSUE or is_interrupted(session, name)):
        message = f"the next key of {name!r} is in force already: its replacement cannot be cancelled"
        help_ = f"end it with 'keymint authority replace {name} --phase end'; then replace the key once more"
        raise KeymintError(message, help=help_, code="rollover-too-late")
    decided = plan_authority_issuance(session, name, replace(authority.issuance, rollover=None), f"{name}: cancelled")
    key, former = (session.tree.read(session.workspace.authority_key(each)) for each in (name, f"{name}.{FORMER}"))
    suffixes = (NEXT, FORMER) if key == former else (NEXT,)  # a run that was killed copied it
    return replace(decided, steps=(*decided.steps, *without_keys(session, name, *suffixes)))


def without_keys(session: Session, name: str, *suffixes: str) -> tuple[Step, ...]:
    """Return what removes the private keys of an authority with some suffixes, e.g. those that a killed run left."""
    paths = {suffix: session.workspace.authority_key(f"{name}.{suffix}") for suffix in suffixes}
    there = {suffix: path for suffix, path in paths.items() if session.tree.has_file(path)}
    changes = {suffix: FolderChange(each.parent, removed=(each.name,), private=True) for suffix, each in there.items()}
    return tuple(Step(STAGE, name, Action.REMOVED, (each,), f"{suffix} key") for suffix, each in changes.items())


def is_interrupted(session: Session, name: str) -> bool:
    """Tell whether a run was killed that put the next authority into force."""
    authority = authority_named(session, name)
    rollover = authority.issuance.rollover
    if rollover is None:
        return False
    in_force = authority_files.stored_key(session, authority, name)
    is_next = in_force is not None and keys.matches(in_force[1], certificates.load(rollover.certificate))
    return is_next and rollover.phase is not Phase.REISSUE


# -- the next authority ----------------------------------------------------------------------------------------------


def _made(session: Session, authority: Authority) -> tuple[bytes, bytes]:
    """Return the certificate and the private key of a new authority of the same name, both PEM."""
    name, spec = authority.name, authority.certificate
    # A key that a killed run left behind is used: nobody trusts it yet.
    found = authority_files.stored_key(session, authority, f"{name}.{NEXT}")
    if found is None or not keys.fits(found[1], spec.key):
        new = keys.generate(spec.key, spec.origin)
        found = keys.to_pem(new, password(session, spec)), new
    pem, key = found
    if spec.adopted:
        return issued_like(session, authority, certificates.load(spec.adopted), key), pem
    if spec.serial is not None:
        message = f"the authority {name!r} has a fixed serial number, which its next certificate must not have as well"
        help_ = "leave <serial_number> empty for a random one"
        raise KeymintError(message, where=spec.origin, help=help_, code="serial-taken")
    renewed = replace(authority.issuance, renewed=periods.begin(session.now))
    after = session.after(plan_authority_issuance(session, name, renewed, "")).session()
    issued_for, signer = authority_named(after, name).certificate, issuer_of(session, authority) or key
    return certificates.issue(issued_for, key.public_key(), signer, authority=True).pem, pem


def _given(
    session: Session, authority: Authority, given: GivenAuthority, present: x509.Certificate
) -> tuple[bytes, bytes]:
    """Return a next authority that was made elsewhere: its certificate, and its private key or nothing.

    Raises:
        KeymintError: as :func:`keymint.authority.authority_changes.cert_and_key`; or it has the present key.
    """
    certificate, key = cert_and_key(session, authority, given)
    if certificate.public_key() == present.public_key():
        message = f"has the present key of the authority {authority.name!r}"
        help_ = f"'keymint authority import {authority.name}' takes a new certificate for it"
        raise KeymintError(message, where=given.where, help=help_, code="authority-unsuitable")
    return certificates.to_pem(certificate), key


def _require_distinct(session: Session, name: str, present: x509.Certificate, following: x509.Certificate) -> None:
    """Require that the authorities of a bundle can be told apart, and that both may sign for the same subjects.

    Raises:
        KeymintError: they have one name, and one of them has no key identifier; or they have different names.
    """
    where = session.workspace.origin(session.workspace.authority_certificate(name))
    if any(extensions.value(each, x509.SubjectKeyIdentifier) is None for each in (present, following)):
        message = f"an authority {name!r} without subjectKeyIdentifier cannot be told from another one of its name"
        help_ = f"'keymint authority renew {name}' adds it; or stage a second keystore, without --vendor"
        raise KeymintError(message, where=where, help=help_, code="authority-without-identifier")
    if present.subject != following.subject:
        message = (
            f"the next authority {name!r} has another subject name than the present one, which some software compares"
        )
        help_ = "give it the same name, or stage a second keystore, without --vendor"
        raise KeymintError(message, where=where, help=help_, code="authority-renamed")


# -- files -----------------------------------------------------------------------------------------------------------


def _former(session: Session, authority: Authority, present: x509.Certificate, following: x509.Certificate) -> bytes:
    """Return the certificate that was in force, also if a killed run replaced its file already.

    Raises:
        KeymintError: no installed enclave has it.
    """
    if present != following:
        return certificates.to_pem(present)
    files = authority_files.read_files(session, authority)
    for each in files.in_use():
        if each != following:
            return certificates.to_pem(each)
    message = f"the former certificate of {authority.name!r} is neither here nor in an enclave"
    raise KeymintError(message, where=files.certificate_file, help="restore it from a backup", code="authority-lost")


def _issuance_of(session: Session, name: str, pem: bytes) -> AuthorityIssuance:
    """Return the decision that makes a certificate the one in force: its dates, or the certificate itself."""
    certificate = certificates.load(pem)
    present = authority_named(session, name)
    plain = replace(present.issuance, adopted=b"", rollover=None)
    if not present.issuance.adopted:
        period = present.certificate.validity
        base = period.not_after - max(present.issuance.renewed or period.not_before, period.not_before)
        plain = replace(plain, renewed=certificate.not_valid_after_utc - base)
        after = session.after(plan_authority_issuance(session, name, plain, "")).session()
        spec = authority_named(after, name).certificate
        issuer = authority_files.stored_certificate(after, spec.issuer) if spec.issuer else None
        if authority_files.satisfies(pem, spec, certificates.public_key(certificate), issuer):
            return plain
    return replace(plain, adopted=pem)


def _require_free_names(session: Session, name: str) -> None:
    """Require that no other authority has the files of the keys that are not in force.

    Raises:
        KeymintError: one has.
    """
    taken = {f"{name}.{suffix}" for suffix in (NEXT, FORMER)}
    for each in session.profile.authorities:
        if each.name in taken:
            message = f"the name of the authority {each.name!r} is needed for a key of {name!r} while it is replaced"
            raise KeymintError(message, where=each.certificate.origin, help="rename it", code="authority-name-taken")
