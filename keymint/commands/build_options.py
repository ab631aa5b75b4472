"""The options that shape the documents of a build."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from comarmor.errors import Diagnostic
from keymint.api import BuildOptions
from keymint.commands.common import Run
from keymint.commands.files import read_input
from keymint.hints import load_hints, unknown_subjects

BUILD_OPTIONS: Sequence[Callable[[Any], Any]] = (
    click.option(
        "--allow-vendor-specific",
        is_flag=True,
        help="Turn into warnings what DDS vendors would decide differently.",
    ),
    click.option(
        "--optimise/--no-optimise",
        default=True,
        show_default=True,
        help="Rewrite permissions into fewer rules and expressions, proven to mean the same.",
    ),
    click.option(
        "--hints",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="What is asked for more often comes earlier: counts (CSV: subject,permission,object,count) or a graph.",
    ),
)


@dataclass(frozen=True, slots=True)
class Hinted:
    """The options of a build, and where its hints come from."""

    options: BuildOptions
    hints: str = ""

    def unknown(self, names: Sequence[str]) -> tuple[Diagnostic, ...]:
        """Return a warning for each subject of the hints that is none of these packages'."""
        return tuple(unknown_subjects(self.options.demand, [f"/{name}" for name in names], self.hints))


def build_options(run: Run, *, allow_vendor_specific: bool, optimise: bool, hints: Path | None) -> Hinted:
    """Return the options of a build as a user gave them.

    Raises:
        KeymintError: the file of hints cannot be read, or is none.
        click.UsageError: there are hints for what is to be left as it is.
    """
    if hints is not None and not optimise:
        raise click.UsageError("--hints is about the order of rules, which --no-optimise leaves as it is.")
    asked = () if hints is None else load_hints(read_input(run, hints), str(hints))
    return Hinted(BuildOptions(allow_vendor_specific, optimise, asked), str(hints or ""))
