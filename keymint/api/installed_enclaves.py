# SPDX-License-Identifier: Apache-2.0
"""Installed enclaves and their files, as transports look for them."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

from comarmor.errors import Origin
from keymint.api.transports import Enclave
from keymint.errors import KeymintError


class EnclavesBySubject(dict[str, Enclave]):
    """The enclaves that a transport decides about; to ask for another one is a :class:`KeymintError`."""

    def __missing__(self, subject: str) -> NoReturn:
        raise KeymintError(f"{subject} has no installed enclave", help="run 'keymint install'", code="enclave-missing")


def installed_file(file: Path) -> bytes:
    """Return an installed file.

    Raises:
        KeymintError: it cannot be read.
    """
    try:
        return file.read_bytes()
    except OSError as error:
        raise KeymintError(
            f"{file.name} cannot be read: {error.strerror}",
            where=Origin(str(file)),
            help="run 'keymint install'",
            code="enclave-file",
        ) from None
