# SPDX-License-Identifier: Apache-2.0
"""Locate the schemas and templates that ship with a package."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from pathlib import Path


@lru_cache
def locate(package: str, kind: str) -> Path:
    """Return the folder of the schemas or templates of a package.

    A wheel ships them in the package, as ``_data/<kind>``. In a checkout, also as an editable install, they are in
    ``<kind>/<package>`` at the project's root. The wheel's place is tried first, so that an installed tool never reads
    a stray checkout.

    Args:
        package: name of the package that owns the files, e.g. ``keymint_ros``.
        kind: ``"schemas"`` or ``"templates"``.

    Raises:
        FileNotFoundError: the installation is damaged.
    """
    for folder in (_folder(package) / "_data" / kind, _folder("comarmor").parent / kind / package):
        if folder.is_dir():
            return folder
    raise FileNotFoundError(
        f"the installation lacks the {kind} of {package}; reinstall Keymint from its checkout or wheel"
    )


def _folder(package: str) -> Path:
    # importlib.resources also finds packages in archives, and takes longer to load than to use.
    return Path(import_module(package).__path__[0])
