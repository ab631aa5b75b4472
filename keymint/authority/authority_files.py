# SPDX-License-Identifier: Apache-2.0
"""The key and certificate files of an authority, and what enclaves trust for it.

Whether they are the ones in use is judged in :mod:`keymint.authority.examine`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence

from cryptography import x509

from comarmor.values import Data, field
from keymint.api import Authority, CertificateSpec, Phase, Rollover
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.pki import certificates, distinguished_names, keys
from keymint.view.stamps import digest_files
from keymint.workspace.installed_enclaves import INSTALLED, deployed_authorities
from keymint.workspace.session import Inputs, Session, once
from keymint.workspace.stored_keys import AUTHORITY_KEYS, load_key, password, recorded_key

COST = "no deployed enclave trusts it until all are redeployed"
"""The consequence of a new authority, for messages."""
NEXT, FORMER = "next", "former"
"""Suffixes of the names of keys and lists that are not in force, while the key of an authority is replaced."""


class AuthorityFiles(Data):
    """The files of an authority.

    Attributes:
        authority: the authority as the profile specifies it.
        key_file: its private key, for messages.
        certificate_file: its certificate, for messages.
        key: content of the key file, or None.
        content: content of the certificate file, or None.
        certificate: its certificate, or None if it is missing or damaged.
        recorded: fingerprint of the recorded key, or empty.
        deployed: returns the authorities' certificates in installed enclaves.
    """

    authority: Authority
    key_file: Origin
    certificate_file: Origin
    key: bytes | None = field(repr=False)
    content: bytes | None
    certificate: x509.Certificate | None
    recorded: str
    deployed: Callable[[], Sequence[x509.Certificate]] = field(repr=False)

    @property
    def name(self) -> str:
        """The name of the authority."""
        return self.authority.name

    @property
    def subject(self) -> x509.Name:
        """The subject name that the profile specifies."""
        spec = self.authority.certificate
        if spec.adopted:
            return certificates.load(spec.adopted).subject
        return distinguished_names.parse(spec.subject_name, spec.origin)

    def in_use(self) -> Sequence[x509.Certificate]:
        """Return the certificates in installed enclaves that have the authority's name, its RDNs in any order."""
        subject = self.subject
        return [each for each in self.deployed() if distinguished_names.has_same_rdns(each.subject, subject)]

    def known(self) -> frozenset[str]:
        """Return the fingerprint of the recorded key, or else those of the keys that installed enclaves trust."""
        return frozenset([self.recorded] if self.recorded else map(certificates.fingerprint, self.in_use()))


def read_files(session: Session, authority: Authority, *, deployed: bool = True) -> AuthorityFiles:
    """Read the files of an authority.

    Args:
        session: the workspace and its profile.
        authority: the authority.
        deployed: installed enclaves are evidence of its certificate.
    """
    workspace, tree, state = session.workspace, session.tree, session.state
    key_path, path = workspace.authority_key(authority.name), workspace.authority_certificate(authority.name)
    content = tree.read(path)
    # Before anything is installed nobody trusts the authority, so the user may replace it with their own.
    is_trusted = state.stamps.get(INSTALLED)
    return AuthorityFiles(
        authority=authority,
        key_file=workspace.origin(key_path),
        certificate_file=workspace.origin(path),
        key=tree.read(key_path),
        content=content,
        certificate=certificates.certificate_in(content),
        recorded=recorded_key(state, AUTHORITY_KEYS, authority.name) if is_trusted else "",
        deployed=functools.partial(deployed_authorities, session) if deployed else tuple,
    )


def stored_certificate(inputs: Inputs, name: str) -> x509.Certificate:
    """Return the certificate of an authority.

    Raises:
        KeymintError: it is missing or damaged.
    """
    path = inputs.workspace.authority_certificate(name)
    return certificates.load(inputs.tree.read(path) or b"", inputs.workspace.origin(path))


def with_issuers(name: str, issuers: Mapping[str, str]) -> Iterator[str]:
    """Yield the names of an authority and of those above it; cycles were refused on loading.

    Args:
        name: the authority.
        issuers: the name of the issuer of each authority, or an empty text.
    """
    while name in issuers:
        yield name
        name = issuers[name]


def in_order(authorities: Sequence[Authority]) -> tuple[Authority, ...]:
    """Return authorities in an order in which each follows its issuer: by the number of those above them."""
    issuers = {each.name: each.certificate.issuer for each in authorities}
    return tuple(sorted(authorities, key=lambda each: len(tuple(with_issuers(each.name, issuers)))))


@once
def trusted_chains(session: Session) -> Mapping[str, bytes]:
    """Return what enclaves trust for each authority, PEM: the authority in force comes first, then those above it.

    While they trust two authorities, the other one follows, and then the revocation lists of both, if there are any.
    """
    chains: dict[str, bytes] = {}
    for authority in in_order(session.profile.authorities):
        name, rollover = authority.name, current_rollover(authority)
        own = session.tree.read(session.workspace.authority_certificate(name)) or b""
        chains[name] = own + chains.get(authority.certificate.issuer, b"")
        if rollover and own:
            paths = (session.workspace.revocation_list(each) for each in (name, other(authority)))
            chains[name] += rollover.certificate + b"".join(session.tree.read(path) or b"" for path in paths)
    return chains


@once
def chains_digest(session: Session) -> str:
    """Return the digest of :func:`trusted_chains`."""
    return digest_files(trusted_chains(session))


def issuers(session: Session) -> Iterator[tuple[str, str, x509.Certificate]]:
    """Yield the authorities that enclaves trust: name of its files, name in the profile, and certificate.

    While the key of an authority is replaced, these are two. A certificate that is missing or damaged is left out.
    """
    for authority in session.profile.authorities:
        name = authority.name
        certificate = certificates.certificate_in(session.tree.try_read(session.workspace.authority_certificate(name)))
        if certificate is not None:
            yield name, name, certificate
        if rollover := current_rollover(authority):
            yield other(authority), name, certificates.load(rollover.certificate)


def current_rollover(authority: Authority) -> Rollover | None:
    """Return the replacement of an authority's key while enclaves trust two certificates of it; else None."""
    rollover = authority.issuance.rollover
    return rollover if rollover is not None and rollover.phase is not Phase.STAGE else None


def other(authority: Authority) -> str:
    """Return the name of the files of an authority's key and list that are not in force; empty if it has none."""
    rollover = authority.issuance.rollover
    if rollover is None:
        return ""
    return f"{authority.name}.{FORMER if rollover.phase is Phase.REISSUE else NEXT}"


def trusted_authorities(session: Session) -> Mapping[x509.Certificate, str]:
    """Return the authorities by their certificates: those in force, and those that take the place of another one."""
    known = {certificate: name for _, name, certificate in issuers(session)}
    rollovers = ((each.name, each.issuance.rollover) for each in session.profile.authorities)
    return known | {certificates.load(each.certificate): name for name, each in rollovers if each}


def authority_keys(session: Session) -> Mapping[str, str]:
    """Return the names of the authorities by the fingerprints of their keys, which none may have but they.

    While the key of an authority is replaced, it has two.
    """
    return {certificates.fingerprint(certificate): name for certificate, name in trusted_authorities(session).items()}


def satisfies(pem: bytes, spec: CertificateSpec, key: keys.PublicKey, issuer: x509.Certificate | None) -> bool:
    """Tell whether an authority's certificate is the one that the profile specifies, or used as it is.

    That is one that was imported, or whose name has its RDNs in another order: with the name of the profile, it would
    be a new authority.
    """
    if spec.adopted or is_reordered(pem, spec):
        certificate = certificates.load(spec.adopted or pem)
        return (
            pem == (spec.adopted or pem)
            and certificate.public_key() == key
            and certificates.is_issued_by(certificate, issuer or certificate)
        )
    return certificates.certificate_satisfies(pem, spec, key, issuer, authority=True)


def is_reordered(pem: bytes, spec: CertificateSpec) -> bool:
    """Tell whether a certificate has the subject name of a specification with its RDNs in another order."""
    name, wanted = certificates.load(pem).subject, distinguished_names.parse(spec.subject_name, spec.origin)
    return name != wanted and distinguished_names.has_same_rdns(name, wanted)


def load_private_key(inputs: Inputs, files: AuthorityFiles) -> keys.PrivateKey:
    """Load the private key of an authority that has one; errors as :func:`keymint.workspace.stored_keys.load_key`."""
    spec = files.authority.certificate
    remedy = f"restore it from a backup; {new_authority_help(files.name)}"
    return load_key(inputs, keys.from_pem, files.key or b"", spec, files.key_file, remedy)


def stored_key(inputs: Inputs, authority: Authority, name: str) -> tuple[bytes, keys.PrivateKey] | None:
    """Return a private key of an authority as it is stored, and loaded; None if it is not here.

    Args:
        inputs: the workspace.
        authority: the authority.
        name: the name of the file: that of the authority, or the one of a key that is not in force.

    Raises:
        KeymintError: it is damaged, or its password is not set or wrong.
    """
    path = inputs.workspace.authority_key(name)
    pem = inputs.tree.read(path)
    if pem is None:
        return None
    return pem, keys.from_pem(pem, password(inputs, authority.certificate), inputs.workspace.origin(path))


def key_elsewhere(name: str, where: Origin, help_: str) -> KeymintError:
    """Return the error on a request for the private key of an authority that is not here.

    Args:
        name: the name of the file: that of the authority, or the one of a key that is not in force.
        where: this file.
        help_: what to do.
    """
    message = f"the private key of the authority {name!r} is not here, and is needed"
    return KeymintError(message, where=where, help=help_, code="authority-key-missing")


def new_authority_help(name: str) -> str:
    """Return the hint that names the option for a new authority, and its consequence."""
    return f"'keymint install --new-authority {name}' makes a new authority ({COST})"


def elsewhere(session: Session) -> Iterator[Diagnostic]:
    """Yield a note for each authority whose private key is not here, which may be meant so."""
    for authority in session.profile.authorities:
        workspace, name = session.workspace, authority.name
        certificate, key = workspace.authority_certificate(name), workspace.authority_key(name)
        is_known = session.tree.has_file(key) or session.tree.is_left_out(key)
        if authority.certificate.key.uri or is_known or not session.tree.has_file(certificate):
            continue
        message = f"the private key of {name!r} is not here"
        help_ = f"no action needed if it is elsewhere; else restore it, or if it is lost: {new_authority_help(name)}"
        yield Diagnostic.note("authority-key-missing", message, workspace.origin(certificate), help_)
