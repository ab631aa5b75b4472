# SPDX-License-Identifier: Apache-2.0
"""Encrypt the stored private key of an authority; the key itself stays."""

from __future__ import annotations

from comarmor.errors import Diagnostic
from keymint.authority import authority_files
from keymint.authority.authority_issuance import STAGE, authority_named
from keymint.errors import KeymintError
from keymint.pki import keys
from keymint.store.changes import Action, Plan, Step, secret_file
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import password


def plan_encryption(session: Session, name: str) -> Plan:
    """Plan to encrypt the private key of an authority; while it is replaced, both keys.

    Args:
        session: the workspace and its profile.
        name: the authority.

    Raises:
        KeymintError: there is no such authority, the profile does not ask for encryption, the key is elsewhere or
            damaged, or its password is not set or wrong.
    """
    authority = authority_named(session, name)
    spec, files = authority.certificate, authority_files.read_files(session, authority)
    if not spec.key.password_env:
        raise KeymintError(
            f"the profile does not ask for an encrypted key of the authority {name!r}",
            where=spec.origin,
            help="write BestAvailableEncryption and a <password_env>, there or in the defaults of authorities",
            code="encryption-unasked",
        )
    if files.key is None:
        raise authority_files.key_elsewhere(name, files.key_file, "encrypt it where it is")
    encrypted = []
    for file in filter(None, (name, authority_files.other(authority))):
        path, stored = session.workspace.authority_key(file), authority_files.stored_key(session, authority, file)
        if stored and not keys.is_encrypted(stored[0]):
            encrypted.append(secret_file(path, keys.to_pem(stored[1], password(session, spec))))
    if not encrypted:
        return Plan((Step(STAGE, name, Action.UNCHANGED),), session.state)
    message, where = "backups and copies of this file still hold the plain key", files.key_file
    help_ = f"delete them, or make a new key with 'keymint authority replace {name}'"
    copies = Diagnostic.warning("key-copies", message, where, help_)
    step = Step(STAGE, name, Action.UPDATED, tuple(encrypted), "private key encrypted")
    return Plan((step,), session.state, (copies,))
