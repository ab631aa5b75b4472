"""Where the schemas and templates that ship with the distribution are found."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path


def locate(kind: str) -> Path:
    """Return the folder of the shipped data of one kind.

    A wheel carries the data inside this package; in a checkout (also an editable install) it lies at the
    project's root. The wheel's place is asked first, so that an installed tool never reads a stray checkout.

    Args:
        kind: ``"schemas"`` or ``"templates"``.

    Raises:
        FileNotFoundError: the installation is damaged: neither place has the folder.
    """
    package = Path(str(files("comarmor")))
    for root in (package / "_data", package.parent):
        folder = root / kind
        if folder.is_dir():
            return folder
    raise FileNotFoundError(
        f"the installation lacks its folder of {kind}; reinstall Keymint from its checkout or wheel"
    )
