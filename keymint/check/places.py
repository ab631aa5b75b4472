"""What is found on files and folders as such: modes and links."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from pathlib import Path

from keymint.errors import Diagnostic, Origin, Severity


def modes(shown: str, path: Path, mode: int, subject: str) -> Iterator[Diagnostic]:
    """Yield a finding for a symbolic link, or for another mode than expected; none if nothing is there."""
    try:
        found = path.lstat().st_mode
    except OSError:
        return
    if stat.S_ISLNK(found):
        yield Diagnostic(
            "file-link",
            Severity.ERROR,
            "is a symbolic link, and breaks when the enclave is copied",
            Origin(shown),
            "remove it and install anew",
            subject,
        )
    elif stat.S_IMODE(found) != mode:
        yield Diagnostic(
            "file-mode",
            Severity.ERROR if stat.S_IMODE(found) & ~mode & 0o077 else Severity.WARNING,
            f"has mode {stat.S_IMODE(found):04o}, expected {mode:04o}",
            Origin(shown),
            f"chmod {mode:o} {shown}",
            subject,
        )
