# SPDX-License-Identifier: Apache-2.0
"""Judge where the private keys of authorities are, and whether they are stored as the profile asks."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic
from keymint.pki import keys
from keymint.plan.authority_files import other
from keymint.session import Session


def elsewhere(session: Session) -> Iterator[Diagnostic]:
    """Yield a note for each authority whose private key is not here, which may be meant so."""
    for authority in session.profile.authorities:
        workspace, name = session.workspace, authority.name
        certificate, key = workspace.authority_certificate(name), workspace.authority_key(name)
        if authority.certificate.key.uri or session.tree.has_file(key) or not session.tree.has_file(certificate):
            continue
        message = f"the private key of {name!r} is not here"
        help_ = "restore it to sign anything"
        yield Diagnostic.note("authority-key-missing", message, workspace.origin(certificate), help_)


def encryption(session: Session) -> Iterator[Diagnostic]:
    """Yield a warning for each private key of an authority that is stored plain, although the profile asks otherwise.

    The PEM says whether a key is encrypted (:func:`keymint.pki.keys.is_encrypted`), so no password is needed.
    """
    for authority in session.profile.authorities:
        if not authority.certificate.key.password_env:
            continue
        for name in filter(None, (authority.name, other(authority))):
            path = session.workspace.authority_key(name)
            pem = session.tree.try_read(path)
            if pem is not None and not keys.is_encrypted(pem):
                message = f"is not encrypted, although {authority.certificate.origin} asks for that"
                help_ = f"'keymint authority encrypt {authority.name}' encrypts it; backups still hold the plain key"
                yield Diagnostic.warning("key-plain", message, session.workspace.origin(path), help_)
