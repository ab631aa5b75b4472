# SPDX-License-Identifier: Apache-2.0
"""The authorities of a workspace: a key and a certificate for each, minted once and kept.

The profile keeps what was decided about them. A private key may lie in a PKCS #11 token.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from cryptography import x509

from comarmor.values import Data, field, replace
from keymint.api import Authority, AuthorityIssuance, SigningAuthority
from keymint.authority import authority_files, examine
from keymint.authority.authority_files import AuthorityFiles
from keymint.errors import Defects, Diagnostic, KeymintError, known_authority
from keymint.pki import certificates, keys
from keymint.store.changes import Action, FolderChange, Plan, Step, folder_changes, secret_file
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import AUTHORITY_KEYS, password, with_recorded_keys

STAGE = "authorities"


def authority_named(session: Session, name: str) -> Authority:
    """Return an authority of the profile.

    Raises:
        KeymintError: there is none of this name; exit code 2.
    """
    known = {authority.name: authority for authority in session.profile.authorities}
    return known[known_authority(name, known, None)]


def plan_authority_issuance(session: Session, name: str, new: AuthorityIssuance, detail: str) -> Plan:
    """Plan what was decided about an authority; of the others it stays.

    Args:
        session: the workspace and its profile.
        name: the authority.
        new: what was decided.
        detail: a few words for the user.

    Raises:
        KeymintError: the type of the profile cannot keep it.
    """
    profile = session.profile
    issuance = {**{each.name: each.issuance for each in profile.authorities}, name: new}
    files = session.profile_type.with_authority_issuance(issuance)
    if files is None:
        message = f"the profile type {profile.profile_type!r} cannot keep what is decided about authorities"
        help_ = "change the dates in the profile instead, and run 'keymint install'"
        raise KeymintError(message, where=session.profile_marker(), help=help_, code="profile-without-issuance")
    changes = folder_changes(session.tree, session.workspace.profile, files)
    return Plan((Step(STAGE, "", Action.UPDATED, changes, detail),) if changes else (), session.state)


_OPTION = "--new-authority"


class MintedAuthority(Data):
    """An authority with its certificate; if its private key is here too, it can issue and sign.

    Attributes:
        certificate: its certificate.
    """

    certificate: x509.Certificate
    _keyed: tuple[certificates.Issuer, SigningAuthority] | KeymintError = field(repr=False)

    @property
    def can_sign(self) -> bool:
        """Whether its private key can be used here."""
        return not isinstance(self._keyed, KeymintError)

    @property
    def issuer(self) -> certificates.Issuer:
        """The issuer of certificates; a KeymintError if its private key is kept elsewhere, or its password not set."""
        return self._with_key()[0]

    @property
    def signer(self) -> SigningAuthority:
        """The signer of documents; errors as for ``issuer``."""
        return self._with_key()[1]

    def _with_key(self) -> tuple[certificates.Issuer, SigningAuthority]:
        if isinstance(self._keyed, KeymintError):
            raise KeymintError.of(self._keyed.diagnostics)
        return self._keyed


Authorities = Mapping[str, MintedAuthority]
"""The authorities of a workspace by name."""


def plan_authorities(session: Session, new: Sequence[str] = ()) -> tuple[Plan, Authorities]:
    """Plan the keys and certificates of all authorities that the profile names.

    Existing keys are kept; a key in a token is never made here. A certificate without its key means that the key is
    kept elsewhere; it is not replaced. A certificate is reissued for the same key if the profile specifies another
    validity, issuer or extension.

    Args:
        session: the workspace and its profile.
        new: authorities that get a new key and certificate, whatever exists.

    Returns:
        The plan, and the authorities by name as they will be.

    Raises:
        KeymintError: a key cannot be read, does not match its certificate, was replaced, is not of the specified
            kind, belongs to another authority, or is needed but kept elsewhere; the defects of all authorities
            together.
    """
    for name in new:
        authority_named(session, name)
    minted: dict[str, MintedAuthority] = {}
    steps: list[Step] = []
    warnings: list[Diagnostic] = []
    defects = Defects()
    for authority in authority_files.in_order(session.profile.authorities):
        if authority.certificate.issuer and authority.certificate.issuer not in minted:
            continue  # its issuer has a defect
        files = authority_files.read_files(session, authority)
        if pem := authority.certificate.adopted:
            files = replace(files, content=pem, certificate=certificates.load(pem))
        with defects:
            result, changes, diagnostics = _plan_authority(session, files, minted, renew=authority.name in new)
            minted[authority.name] = result
            warnings += diagnostics
            action = Action.CREATED if changes else Action.UNCHANGED
            steps.append(Step(STAGE, authority.name, action, changes, "certificate authority"))
    # Advice about one authority must not take back what was done about another.
    given = "".join(f"{_OPTION} {name} " for name in new) + _OPTION
    defects.found = [replace(each, help=each.help.replace(_OPTION, given)) for each in defects.found]
    defects.require_none()  # one token may fail several authorities
    fingerprints = {name: certificates.fingerprint(each.certificate) for name, each in minted.items()}
    examine.require_own_keys(session, fingerprints)
    state = with_recorded_keys(session.state, AUTHORITY_KEYS, fingerprints)
    return Plan(tuple(steps), state, tuple(warnings)), minted


def _plan_authority(
    inputs: Inputs, files: AuthorityFiles, minted: Mapping[str, MintedAuthority], *, renew: bool
) -> tuple[MintedAuthority, tuple[FolderChange, ...], Sequence[Diagnostic]]:
    spec, name = files.authority.certificate, files.name
    above = minted[spec.issuer] if spec.issuer else None
    if renew:
        _require_replaceable(files)
    signing_error = None if spec.key.uri else _signing_error(inputs, files)
    if signing_error is not None and files.content is not None and not renew:
        return _without_key(files, above, signing_error), _stored(inputs, name, files.content), ()
    secret = password(inputs, spec)
    changes: tuple[FolderChange, ...] = ()
    pem, is_new = files.key or b"", renew
    if spec.key.uri:  # the token is opened only if a certificate must be issued
        key, pem = token_key(inputs, files, renew=renew), b""
    elif files.key is None or renew:
        if not renew:
            examine.require_unused(files)
        key, is_new = keys.generate(spec.key, spec.origin), True
        pem = keys.to_pem(key, secret)
        changes = (secret_file(inputs.workspace.authority_key(name), pem),)
    else:
        key = authority_files.load_private_key(inputs, files)
    if is_new:
        message = f"{name!r} is a new authority: {authority_files.COST}"
        new = Diagnostic.warning("authority-new", message, files.certificate_file)
        certificate, warnings = _issued(files, key, above, [new] if files.known() else [])
    else:
        examine.require_rollover(files, key.public_key())
        examine.require_in_use(files, key.public_key())
        certificate, warnings = _certificate(files, key, above)
    changes += _stored(inputs, name, certificate)
    signer = SigningAuthority(name, certificate, pem, secret, token_key=key if spec.key.uri else None)
    issuer = certificates.Issuer(certificates.load(certificate), key)
    left_over = key_copies(files) if spec.key.uri else ()
    return MintedAuthority(issuer.certificate, (issuer, signer)), changes, (*warnings, *left_over)


def _stored(inputs: Inputs, name: str, certificate: bytes) -> tuple[FolderChange, ...]:
    path = inputs.workspace.authority_certificate(name)
    return folder_changes(inputs.tree, path.parent, {path.name: certificate})


def _require_replaceable(files: AuthorityFiles) -> None:
    """Require that an authority may be replaced at once.

    Raises:
        KeymintError: its certificate is from elsewhere, or its replacement is under way.
    """
    issuance, name = files.authority.issuance, files.name
    if issuance.rollover or issuance.adopted:
        why = "its replacement is under way" if issuance.rollover else "its certificate was imported"
        message = f"the authority {name!r} is not made again at once: {why}"
        help_ = f"use 'keymint authority replace {name}'"
        raise KeymintError(message, where=files.certificate_file, help=help_, code="authority-not-minted")


def _issued(
    files: AuthorityFiles, key: keys.PrivateKey, above: MintedAuthority | None, warnings: Sequence[Diagnostic]
) -> tuple[bytes, Sequence[Diagnostic]]:
    signer = above.issuer if above else key
    issued = certificates.issue(files.authority.certificate, key.public_key(), signer, authority=True)
    return issued.pem, (*issued.diagnostics, *warnings)


def _certificate(
    files: AuthorityFiles, key: keys.PrivateKey, above: MintedAuthority | None
) -> tuple[bytes, Sequence[Diagnostic]]:
    """Return the certificate of a key: an existing one if the profile still specifies it, else a new one."""
    spec = files.authority.certificate
    for candidate in _candidates(files):
        pem = certificates.to_pem(candidate)
        if authority_files.satisfies(pem, spec, key.public_key(), above.certificate if above else None):
            return pem, ()
    if spec.adopted:
        raise KeymintError(
            f"the certificate that the profile adopts for {files.name!r} was not issued by "
            f"{repr(spec.issuer) if spec.issuer else 'itself'}",
            where=spec.origin,
            help="correct <issuer_name>, or import the certificate of its issuer first",
            code="authority-issuer-elsewhere",
        )
    again = Diagnostic.warning(
        "authority-reissued",
        f"the certificate of the authority {files.name!r} is reissued for the same key",
        files.certificate_file,
        "deploy all enclaves together: if it signs rights, subjects with different certificates of it cannot "
        "communicate on some vendors",
    )
    return _issued(files, key, above, [again] if files.in_use() else [])


def _candidates(files: AuthorityFiles) -> Iterator[x509.Certificate]:
    if files.certificate is not None:
        yield files.certificate
    yield from files.in_use()


def _signing_error(inputs: Inputs, files: AuthorityFiles) -> KeymintError | None:
    """Return the error to raise if this CA must sign, or None; an offline root is no defect."""
    if files.key is None:
        help_ = f"restore it; {authority_files.new_authority_help(files.name)}"
        return authority_files.key_elsewhere(files.name, files.key_file, help_)
    try:
        password(inputs, files.authority.certificate)
    except KeymintError as error:
        return error
    return None


def _without_key(files: AuthorityFiles, above: MintedAuthority | None, signing_error: KeymintError) -> MintedAuthority:
    """Return an authority whose private key cannot be used here.

    Raises:
        KeymintError: the certificate is damaged or was replaced, or the profile specifies another one, which needs
            the key.
    """
    spec, content = files.authority.certificate, files.content or b""
    certificate = certificates.load(content, files.certificate_file)
    public_key = certificates.public_key(certificate, files.certificate_file)
    examine.require_rollover(files, public_key)
    examine.require_in_use(files, public_key)
    if not keys.fits(public_key, spec.key) or not authority_files.satisfies(
        content, spec, public_key, above.certificate if above else None
    ):
        raise signing_error
    return MintedAuthority(certificate, signing_error)


def token_key(inputs: Inputs, files: AuthorityFiles, *, renew: bool) -> keys.PrivateKey:
    """Return the private key of an authority, which the profile names by its URI.

    The token is opened only if there is no certificate that says what its public key is. Otherwise it is opened when
    the key first signs, and must then be the key of the certificate.

    Args:
        inputs: the workspace.
        files: the authority and its files.
        renew: the authority gets a new certificate, for a key that the user has put into the token.

    Raises:
        KeymintError: enclaves trust an authority whose certificate is missing; the key is not of the specified kind, or
            for a new authority still the old one; or those of :class:`keymint.pki.tokens.token_sessions.Tokens`.
    """
    spec, name = files.authority.certificate, files.name
    present = files.certificate
    if present is not None and not renew:
        public, where = certificates.public_key(present), files.certificate_file
    else:
        if not renew:
            examine.require_unused(files)
        public, where = inputs.tokens().public_key(spec.key, spec.origin), spec.origin
    if not keys.fits(public, spec.key):
        raise KeymintError(
            f"the key of the authority {name!r} is not {keys.key_description(spec.key)}, which {spec.origin} asks for",
            where=where,
            help="write the type of the token's key into <asymmetric_type>",
            code="key-kind",
        )
    if renew and present is not None and certificates.public_key(present) == public:
        raise KeymintError(
            f"the token still has the key of the present authority {name!r}",
            where=spec.origin,
            help="make a new key in the token, and name it in <pkcs11>; a new certificate for the same key needs no "
            "new authority",
            code="authority-key-same",
        )
    return inputs.tokens().private_key(spec.key, public, spec.origin)


def key_copies(files: AuthorityFiles) -> Iterator[Diagnostic]:
    """Yield a warning if the private key lies in a file as well as in its token."""
    if files.key is not None:
        message = f"is a private key of the authority {files.name!r}, whose key is to lie in a token only"
        help_ = "move it to a safe place that is no computer's disk, or destroy it"
        yield Diagnostic.warning("authority-key-copy", message, files.key_file, help_)


def only_in_token(authority: Authority, help_: str) -> KeymintError:
    """Return the error on a request for the file of a private key that lies in a token.

    Args:
        authority: the authority.
        help_: what to do.
    """
    message = f"the private key of the authority {authority.name!r} lies in a token, not in a file"
    return KeymintError(message, where=authority.certificate.origin, help=help_, code="authority-in-token")
