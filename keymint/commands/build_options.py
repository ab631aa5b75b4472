"""The options of a build, with hints loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import click

from comarmor.errors import Diagnostic
from keymint.api import BuildOptions
from keymint.commands.options import DocumentOptions
from keymint.commands.run import Run
from keymint.commands.user_files import read_input
from keymint.hints import load_hints, unknown_subjects


@dataclass(frozen=True, slots=True)
class Hinted:
    """The options of a build, and the file of its hints."""

    options: BuildOptions
    hints: str = ""

    def unknown(self, names: Sequence[str]) -> tuple[Diagnostic, ...]:
        """Return a warning for each subject of the hints without a package."""
        return tuple(unknown_subjects(self.options.demand, [f"/{name}" for name in names], self.hints))


def build_options(run: Run, given: DocumentOptions) -> Hinted:
    """Return the options of a build.

    Raises:
        KeymintError: the file of hints cannot be read, or is malformed.
        click.UsageError: hints are given without optimisation.
    """
    if given.hints is not None and not given.optimise:
        raise click.UsageError("--hints changes the order of rules, which --no-optimise keeps.")
    demand = () if given.hints is None else load_hints(read_input(run, given.hints), str(given.hints))
    return Hinted(BuildOptions(given.allow_vendor_specific, given.optimise, demand), str(given.hints or ""))
