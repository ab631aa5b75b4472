# SPDX-License-Identifier: Apache-2.0
"""Whether Zenoh's library for Python is installed: a wheel with access control, TLS, and routers."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys

DISTRIBUTION = "eclipse-zenoh"
OLDEST = (1, 6)
"""Before 1.6.0 one of several matching subjects decided, in the order of a hash table."""


class MissingZenohError(Exception):
    """The library is not installed, or is too old; with how to install it.

    Args:
        reason: what is missing.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        self.help = f"pip install {DISTRIBUTION}, in Keymint's environment {sys.prefix}"
        super().__init__(f"Zenoh: {reason}; {self.help}")


def installed_version() -> str:
    """Return the version of the installed library, without loading it.

    Raises:
        MissingZenohError: it is not installed, or is too old.
    """
    if importlib.util.find_spec("zenoh") is None:
        raise MissingZenohError(f"no library {DISTRIBUTION}")
    try:
        version = importlib.metadata.version(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        raise MissingZenohError(f"no library {DISTRIBUTION}") from None
    numbers = tuple(int(part) if part.isdigit() else 0 for part in version.split(".")[:2])
    if numbers < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        raise MissingZenohError(f"{DISTRIBUTION} {version} is older than {oldest}")
    return version
