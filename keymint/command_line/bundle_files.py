# SPDX-License-Identifier: Apache-2.0
"""Where bundles are written, for the verbs that make them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from keymint.command_line.named_files import is_folder, show_written, write_outputs
from keymint.command_line.options import PATH
from keymint.errors import usage_error
from keymint.output.report import members
from keymint.robots.bundle_making import MadeBundle
from keymint.run.run import Run

bundle_output_option = click.option(
    "-o",
    "--output",
    type=PATH,
    metavar="PATH",
    help="File of the bundle, or folder of several, which are named NAME.bundle [the current directory].",
)


def require_output(run: Run, output: Path | None, number: int) -> None:
    """Require that several bundles go to a folder.

    Raises:
        KeymintError: they do not; a usage error.
    """
    if number > 1 and output is not None and not is_folder(run, output):
        raise usage_error(f"{output} is no folder, and there are {number} bundles", "make the folder, or name another")


def write_bundles(run: Run, output: Path | None, made: Sequence[MadeBundle]) -> list[dict[str, Any]]:
    """Write bundles, each complete or not at all, and say what they are.

    Returns:
        Each bundle for ``--json``.

    Raises:
        KeymintError: the system refuses.
    """
    documents = []
    for each in made:
        file = f"{each.manifest.name.replace('/', '.')}.bundle"
        target = Path(file) if output is None else output / file if is_folder(run, output) else output
        show_written(run, target, write_outputs(run, target, each.content, secret=each.secret))
        if each.secret:
            run.console.line(
                f"  it has the private key of {each.manifest.enclave}: whoever reads it can act as this enclave"
            )
        documents.append(
            {
                "enclave": each.manifest.enclave,
                "file": str(target),
                "has_private_key": each.secret,
                **members(each.manifest, "key", "authority", "generation", "issue", "revocations", "not_after"),
            }
        )
    run.console.lines(
        f"on a robot that has nothing of this authority yet: keymint accept --authority-fingerprint {authority}"
        for authority in dict.fromkeys(each.manifest.authority for each in made)
    )
    return documents
