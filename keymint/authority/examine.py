# SPDX-License-Identifier: Apache-2.0
"""Judge the key and the certificate of an authority by all evidence for which they should be.

That is the private key beside the certificate, the record of keys in use, the profile, and what installed enclaves
trust. A replaced key or certificate is an error here: only a person can know which of the files is right.

Proofs rest on the certificates in ``public/``. If the other evidence contradicts a certificate, or its file contains
more than one, nothing that rests on it is claimed (:func:`contradictions`). There enclaves are no evidence.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

from cryptography import x509

from keymint.authority.authority_files import AuthorityFiles, in_order, new_authority_help, read_files
from keymint.errors import Defects, Diagnostic, KeymintError, Origin
from keymint.pki import certificates, distinguished_names, keys
from keymint.workspace.package_build_types import is_build_current, issuers_of
from keymint.workspace.session import Session, once
from keymint.workspace.stored_keys import AUTHORITY_KEYS, password, recorded_key

DECIDED_BY_A_PERSON = frozenset(
    {
        "authority-key-mismatch",
        "authority-key-shared",
        "authority-renamed",
        "authority-replaced",
        "key-invalid",
        "key-kind",
    }
)
"""Codes of the findings on an authority that a person must decide before anything is installed."""


def require_pair(
    key: keys.PrivateKey | keys.PublicKey, certificate: x509.Certificate, where: Origin | None, of: str, help_: str
) -> None:
    """Require that a private key is that of the certificate with which it is to come into force.

    Args:
        key: the key, or its public half.
        certificate: the certificate.
        where: the file of the key.
        of: what the certificate is called.
        help_: what to do.

    Raises:
        KeymintError: it is another key.
    """
    if not keys.matches(key, certificate):
        raise KeymintError(f"is not the private key of {of}", where=where, help=help_, code="authority-key-mismatch")


def require_unused(files: AuthorityFiles) -> None:
    """Require that no enclave trusts an authority that has neither key nor certificate here.

    Raises:
        KeymintError: one does, so the files were lost.
    """
    if files.in_use():
        raise KeymintError(
            f"the authority {files.name!r} has neither key nor certificate here, but enclaves that are installed trust "
            "it",
            where=files.certificate_file,
            help=f"restore them, or the certificate alone from an enclave; {new_authority_help(files.name)}",
            code="authority-lost",
        )


def require_known(files: AuthorityFiles, key: keys.PublicKey, given: Origin | None = None) -> None:
    """Require that the authority's key was not replaced.

    Args:
        files: the files of the authority.
        key: the key of its certificate.
        given: the file with the certificate, if a user named one that is to be used.

    Raises:
        KeymintError: the record, or if it was lost every installed enclave, has another key of this authority.
    """
    known = files.known()
    if not known or keys.fingerprint(key) in known:
        return
    help_ = f"restore {files.key_file} and {files.certificate_file}; {new_authority_help(files.name)}"
    if given:
        help_ = f"'keymint authority replace {files.name} --certificate {given.file}' replaces it step by step"
    message = f"the key of the authority {files.name!r} was replaced: the deployed enclaves trust another one"
    where = given or (files.certificate_file if files.key is None else files.key_file)
    raise KeymintError(message, where=where, help=help_, code="authority-replaced")


def require_in_use(files: AuthorityFiles, key: keys.PublicKey) -> None:
    """Require that a private key is the one of the certificate, and that nobody exchanged both.

    Raises:
        KeymintError: it is not, and then names the wrong file, if that is known. Or the certificate has another subject
            name than the profile, its RDNs in any order: with the profile's name it would be a new authority. Or as
            :func:`require_known`.
    """
    present, spec, new_help = files.certificate, files.authority.certificate, new_authority_help(files.name)
    if present is not None:
        if not keys.matches(key, present) and keys.fingerprint(key) in files.known():
            message = f"is the certificate of another key than {files.key_file}, which is the key of {files.name!r}"
            help_ = f"restore it, or remove it and run 'keymint install'; {new_help}"
            raise KeymintError(message, where=files.certificate_file, help=help_, code="authority-key-mismatch")
        help_ = f"restore the file that is wrong; {new_help}"
        require_pair(key, present, files.key_file, str(files.certificate_file), help_)
        if not distinguished_names.has_same_rdns(present.subject, files.subject):
            found, wanted = map(distinguished_names.to_text, (present.subject, files.subject))
            message = f"is for {found!r}, but {spec.origin} asks for {wanted!r}"
            help_ = f"restore the file or the subject_name; {new_help}"
            raise KeymintError(message, where=files.certificate_file, help=help_, code="authority-renamed")
    require_known(files, key)


def require_rollover(files: AuthorityFiles, key: keys.PublicKey) -> None:
    """Require that the key in force is not the one that the profile exchanges it with.

    Raises:
        KeymintError: it is, because a run that exchanges them was killed.
    """
    rollover = files.authority.issuance.rollover
    if rollover and certificates.public_key(certificates.load(rollover.certificate)) == key:
        message = f"the replacement of the key of {files.name!r} was interrupted"
        help_ = f"'keymint authority replace {files.name}' goes on"
        raise KeymintError(message, where=files.key_file, help=help_, code="rollover-interrupted")


def require_own_keys(session: Session, fingerprints: Mapping[str, str]) -> None:
    """Require that no two authorities have the same key, with which each could act as the other.

    Args:
        session: the workspace and its profile.
        fingerprints: fingerprint of each authority's key, by name.

    Raises:
        KeymintError: two authorities have the same key.
    """
    owners: dict[str, str] = {}
    for name, fingerprint in fingerprints.items():
        other = owners.setdefault(fingerprint, name)
        if other != name:
            stamped = recorded_key(session.state, AUTHORITY_KEYS, other) == fingerprint
            wrong = name if stamped else other
            raise KeymintError(
                f"the authorities {other!r} and {name!r} have one and the same key",
                where=session.workspace.origin(session.workspace.authority_certificate(wrong)),
                help=f"restore {wrong!r}; or, in a token after another <pkcs11>, {new_authority_help(wrong)}",
                code="authority-key-shared",
            )


# -- what contradicts a certificate ----------------------------------------------------------------------------------


@once
def contradictions(session: Session) -> Mapping[str, tuple[Diagnostic, ...]]:
    """Return the contradictions of all authorities of a workspace that have any.

    Those of an issuer count for the authorities below it. A missing certificate is no contradiction.
    """
    by_authority: dict[str, tuple[Diagnostic, ...]] = {}
    for authority in in_order(session.profile.authorities):
        files = read_files(session, authority, deployed=False)
        key: keys.PublicKey | None = None
        if files.key is not None and not authority.certificate.key.uri:
            with suppress(KeymintError):  # a private key that cannot be read is no evidence
                key = keys.public_of(files.key, password(session, authority.certificate))
        own = () if files.content is None else certificate_contradictions(files, key)
        if all_ := (*own, *by_authority.get(authority.certificate.issuer, ())):
            by_authority[authority.name] = all_
    return by_authority


def contradictions_for(session: Session, name: str) -> tuple[Diagnostic, ...]:
    """Return the contradictions of the authorities that the enclave of a package rests on, each once.

    Raises:
        KeymintError: the package has defects.
    """
    known = contradictions(session)
    issuers = issuers_of(session, session.package(name, built=is_build_current(session, name))) if known else ()
    return tuple(dict.fromkeys(each for issuer in issuers for each in known.get(issuer, ())))


def certificate_contradictions(files: AuthorityFiles, key: keys.PublicKey | None) -> tuple[Diagnostic, ...]:
    """Return what contradicts the certificate of an authority: its form, its key, its name, and what is recorded.

    Args:
        files: the files of the authority, of which the certificate is there.
        key: the public key of its private key; None if that is not known.
    """
    content, where, adopted = files.content or b"", files.certificate_file, files.authority.certificate.adopted
    defects = Defects()
    with defects:
        # Transports differ in what they read of a file with several blocks: some trust each certificate in it.
        certificates.load(content, where)
        public = certificates.public_key(certificates.load_first(content, where), where)
        if adopted and content != adopted:
            message = f"is not the certificate that was imported for the authority {files.name!r}"
            help_ = "'keymint install' restores it; 'keymint authority import' takes another one"
            raise KeymintError(message, where=where, help=help_, code="authority-drift")
        require_in_use(files, key or public)
    return tuple(defects.found)
