# SPDX-License-Identifier: Apache-2.0
"""Whether Zenoh's library for Python is installed: a wheel with access control, TLS, and routers."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys

from keymint.host.vendor_process import MissingVendorError

DISTRIBUTION = "eclipse-zenoh"
OLDEST = (1, 6)
"""Before 1.6.0 one of several matching subjects decided, in the order of a hash table."""


def installed_version() -> str:
    """Return the version of the installed library, without loading it.

    Raises:
        MissingVendorError: it is not installed, or is too old.
    """
    if importlib.util.find_spec("zenoh") is None:
        raise _missing(f"no library {DISTRIBUTION}")
    try:
        version = importlib.metadata.version(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        raise _missing(f"no library {DISTRIBUTION}") from None
    numbers = tuple(int(part) if part.isdigit() else 0 for part in version.split(".")[:2])
    if numbers < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        raise _missing(f"{DISTRIBUTION} {version} is older than {oldest}")
    return version


def _missing(reason: str) -> MissingVendorError:
    return MissingVendorError("Zenoh", reason, f"pip install {DISTRIBUTION}, in Keymint's environment {sys.prefix}")
