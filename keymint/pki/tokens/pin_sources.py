# SPDX-License-Identifier: Apache-2.0
"""Where the PIN of a token comes from: a file, an environment variable, or a prompt. It is written nowhere.

No error here contains a PIN.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Mapping
from dataclasses import field

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.errors import KeymintError

VARIABLE = "KEYMINT_PKCS11_PIN"
"""The environment variable of the PIN where none is named."""
MISSING, REFUSED = "token-pin-missing", "token-pin-file"
"""Codes of errors: there is no PIN; the file that has it is not usable."""
_MOST = 255
"""Bytes of a PIN: the longest length that tokens return is a small number (CK_TOKEN_INFO.ulMaxPinLen)."""


@dataclass(frozen=True, slots=True)
class Pins:
    """The sources of PINs of one run.

    Attributes:
        environment: environment variables.
        ask: shows a text to the user and returns what they type, unseen; None if there is no terminal.
    """

    environment: Mapping[str, str] = field(repr=False)
    ask: Callable[[str], str] | None = None

    def pin(self, token: str, file: str, variable: str, where: Origin | None = None) -> str:
        """Return the PIN of a token.

        Args:
            token: the token as messages and the prompt name it.
            file: absolute path of the file that has the PIN; empty if none is named.
            variable: name of the environment variable that has it; empty if none is named.
            where: the place that names the key, for messages.

        Raises:
            KeymintError: ``token-pin-missing``: no source has one. ``token-pin-file``: others may read the file, or it
                has no PIN.
        """
        if file:
            return _from_file(file, where)
        variable = variable or VARIABLE
        pin = self.environment.get(variable, "")
        if not pin and self.ask is not None:
            pin = self.ask(f"PIN of the token {token}: ")
        if not pin:
            raise KeymintError(
                f"the environment variable {variable}, which holds the PIN of the token {token}, is not set",
                where=where,
                help=f"export {variable}=…, run it in a terminal, or name a file of mode 0600: ?pin-source=file:/path",
                code=MISSING,
            )
        return pin


def _from_file(path: str, where: Origin | None) -> str:
    """Return the PIN of a file, without the end of its line."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as opened:
            status = os.fstat(descriptor)
            problem = _problem(status)
            content = b"" if problem else opened.read(_MOST + 2)
    except OSError as error:
        problem, content = f"cannot be read: {error.strerror}", b""
    lines = content.splitlines()
    if not problem and (len(lines) != 1 or not 0 < len(lines[0]) <= _MOST):
        problem = f"is not one line with a PIN of at most {_MOST} bytes"
    try:
        pin = lines[0].decode() if lines else ""
    except UnicodeDecodeError:
        problem = problem or "is not UTF-8"
    if problem:
        raise KeymintError(
            f"the PIN file {path} {problem}",
            where=where,
            help=f"write the PIN into a file of yours, and run: chmod 600 {path}",
            code=REFUSED,
        )
    return pin


def _problem(status: os.stat_result) -> str:
    """Return why a PIN must not be read from a file, or an empty text."""
    if not stat.S_ISREG(status.st_mode):
        return "is not a regular file"
    if status.st_uid not in {os.geteuid(), 0}:
        return "belongs to another user"
    mode = stat.S_IMODE(status.st_mode)
    return f"has mode {mode:04o}, so others may read or change it; expected 0600" if mode & 0o077 else ""
