# SPDX-License-Identifier: Apache-2.0
"""Authorities whose private key lies in a PKCS #11 token."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic
from keymint.api import Authority
from keymint.authority import authority_files
from keymint.authority.authority_files import AuthorityFiles
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.workspace.session import Inputs


def load(inputs: Inputs, files: AuthorityFiles, *, renew: bool) -> keys.PrivateKey:
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
            authority_files.require_unused(files)
        public, where = inputs.tokens.public_key(spec.key, spec.origin), spec.origin
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
    return inputs.tokens.private_key(spec.key, public, spec.origin)


def left_over(files: AuthorityFiles) -> Iterator[Diagnostic]:
    """Yield a warning if the private key lies in a file as well as in its token."""
    if files.key is not None:
        yield Diagnostic.warning(
            "authority-key-copy",
            f"is a private key of the authority {files.name!r}, whose key is to lie in a token only",
            files.key_file,
            "move it to a safe place that is no computer's disk, or destroy it",
        )


def only_in_token(authority: Authority, help_: str) -> KeymintError:
    """Return the error on a request for the file of a private key that lies in a token.

    Args:
        authority: the authority.
        help_: what to do.
    """
    return KeymintError(
        f"the private key of the authority {authority.name!r} lies in a token, not in a file",
        where=authority.certificate.origin,
        help=help_,
        code="authority-in-token",
    )
