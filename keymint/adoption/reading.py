# SPDX-License-Identifier: Apache-2.0
"""Read a keystore by the build type that knows its files."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

from keymint.adoption.keystore_files import read_keystore
from keymint.api import FoundKeystore, KeystoreFiles, KeystoreReader
from keymint.api.plugin_loader import Plugins
from keymint.errors import KeymintError


def found_in(plugins: Plugins, folder: Path, typed: str, now: datetime) -> tuple[str, KeystoreFiles, FoundKeystore]:
    """Return the build type that reads a keystore, the files of the keystore, and what it has.

    Files that cannot be read are findings.

    Args:
        plugins: the plugins.
        folder: the folder of the keystore.
        typed: the same as the user typed it.
        now: the clock, UTC.

    Raises:
        KeymintError: there is no such folder, it has no enclave, or no plugin reads keystores.
    """
    files, problems = read_keystore(folder, typed, now)
    for name in plugins.names("keymint.build_types"):
        build_type: object = plugins.build_type(name)
        if isinstance(build_type, KeystoreReader):
            found = build_type.found(files)
            return name, files, replace(found, diagnostics=(*problems, *found.diagnostics))
    raise KeymintError(
        "no installed build type reads keystores", help="'keymint plugins' lists them", code="adopt-unsupported"
    )
