# SPDX-License-Identifier: Apache-2.0
"""Show reports and progress on a terminal, or reports as JSON."""

from __future__ import annotations

import io
import itertools
import json
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import datetime
from operator import attrgetter
from typing import IO, Any, TypeVar

from comarmor.text import encodable_value, natural_order, one_line, printable_lines, quantity
from comarmor.values import Data, replace
from keymint.errors import Diagnostic, ExitCode, Severity
from keymint.host.streams_and_signals import Output
from keymint.output.report import Report, report_json, rolled_up
from keymint.store.changes import Action, Step

COLOURS = ("auto", "always", "never")
"""Values of ``--color``."""
_COLOURS: Mapping[Severity, str] = {
    Severity.ERROR: "31",
    Severity.WARNING: "33",
    Severity.NOTE: "36",
}
_T = TypeVar("_T", Diagnostic, Step, str)
_PROGRESS_AFTER = 1.0
"""Seconds of work before a progress bar appears."""


class Streams(Data):
    """The output streams of a run.

    Attributes:
        out: results.
        err: diagnostics and progress.
        colour_out: ``out`` may have colours.
        colour_err: ``err`` may have colours.
        progress: ``err`` is a terminal that a progress bar may be drawn on.
        width: columns of a table; None if ``out`` is no terminal: about 80, but words stay in one piece.
    """

    out: IO[str]
    err: IO[str]
    colour_out: bool = False
    colour_err: bool = False
    progress: bool = False
    width: int | None = None


class Console:
    """Shows the progress and the results of a run.

    Args:
        streams: output streams.
        verbosity: -1 quiet, 0 usual, 1 and more: every step and file.
        as_json: one JSON document on ``out`` in place of words.
    """

    def __init__(self, streams: Streams, *, verbosity: int = 0, as_json: bool = False) -> None:
        self._streams = streams
        self._verbosity = verbosity
        self._json = as_json

    # -- while it runs -------------------------------------------------------------------------------------------

    def waiting(self, process: str) -> None:
        """Report that another run holds the workspace lock: its process in words, or an empty text."""
        self._say_err(f"Waiting for the workspace lock held by another keymint process{process}")

    @contextmanager
    def progress(self, total: int, clock: Any) -> Iterator[Any]:
        """Yield a function to call after each step; draws a progress bar if the work takes long.

        Args:
            total: number of steps.
            clock: returns seconds, monotonic.
        """
        if not self._streams.progress or self._json or self._verbosity < 0:
            yield lambda _step: None
            return
        start, done = clock(), itertools.count(1)
        with ExitStack() as stack:
            bar: Any = None

            def advance(step: Step) -> None:
                nonlocal bar
                number = next(done)
                if bar is None and clock() - start >= _PROGRESS_AFTER:
                    bar = stack.enter_context(_bar(self._streams))
                    bar.add_task(step.stage, total=total)
                if bar is not None:
                    bar.update(bar.task_ids[0], completed=number, description=step.stage)

            yield advance

    # -- when it is done -----------------------------------------------------------------------------------------

    def show(self, report: Report) -> None:
        """Show a report as JSON, or its steps and diagnostics as text."""
        if self._json:
            document = json.dumps(encodable_value(report_json(report)), indent=2, ensure_ascii=True)
            self._streams.out.write(f"{document}\n")
            return
        self.diagnostics(report.diagnostics, report.notes)
        if self._verbosity < 0 and report.exit_code == ExitCode.FINDINGS:
            hidden = report.diagnostics
            if hidden and all(each.severity is not Severity.ERROR for each in hidden):
                self._say_err(f"{quantity(len(hidden), 'message')} not shown (leave out -q)")
        if self._verbosity >= 0:
            self._steps(report)

    def rendered(self, report: Report, show: Callable[[Console], None] = lambda _: None) -> tuple[str, str]:
        """Return what a report shows as results and as diagnostics.

        Args:
            report: the report.
            show: shows what the verb shows before it.
        """
        out, err = io.StringIO(), io.StringIO()
        console = Console(replace(self._streams, out=out, err=err), verbosity=self._verbosity, as_json=self._json)
        show(console)
        console.show(report)
        return out.getvalue(), err.getvalue()

    def diagnostics(self, diagnostics: Sequence[Diagnostic], notes: bool | Collection[str] = False) -> None:
        """Show diagnostics: ``place: severity: message (help) [code]``; many that are alike as one line.

        Args:
            diagnostics: the diagnostics.
            notes: whether notes are shown although the output is not verbose, or the codes of those that are.
        """
        for diagnostic, number in self._rolled_up(_in_order(diagnostics, "code", "subject")):
            shown = notes if isinstance(notes, bool) else diagnostic.code in notes
            self._diagnostic(diagnostic, number, notes=shown)

    def _diagnostic(self, diagnostic: Diagnostic, number: int, *, notes: bool) -> None:
        if diagnostic.severity is Severity.NOTE and self._verbosity < (0 if notes else 1):
            return
        if diagnostic.severity is Severity.WARNING and self._verbosity < 0:
            return
        place = f"{diagnostic.where}: " if diagnostic.where else ""
        label = _paint(f"{diagnostic.severity}:", _COLOURS[diagnostic.severity], colour=self._streams.colour_err)
        hint = f" ({diagnostic.help})" if diagnostic.help else ""
        about = f" [{diagnostic.code}]{_others(number)}"
        self._say_err(f"{one_line(place)}{label} {one_line(diagnostic.message + hint + about)}")

    def _rolled_up(self, items: Sequence[_T]) -> Iterator[tuple[_T, int]]:
        """Yield what is shown of items, each with the number of those that it stands for: all of them if verbose."""
        return rolled_up(items) if self._verbosity < 1 else ((each, 1) for each in items)

    def line(self, text: str = "") -> None:
        """Show a line of a result unless quiet or JSON, with unprintable characters escaped."""
        self._line(one_line(text))

    def messages(self, texts: Sequence[str]) -> None:
        """Show lines that say what was done; many that are alike as one line. See :meth:`line`."""
        for text, number in self._rolled_up(texts):
            self.line(text + _others(number))

    def lines(self, texts: Iterable[str]) -> None:
        """Show lines of a result; see :meth:`line`."""
        for text in texts:
            self.line(text)

    def document(self, content: bytes) -> None:
        """Write a document that is the result, also if quiet: who asked for it reads it. Not in JSON.

        Written byte for byte into files and pipes; on a terminal unprintable characters are escaped.

        Args:
            content: UTF-8; ends with exactly one newline in the output.
        """
        if self._json:
            return
        content = content.rstrip(b"\n") + b"\n"
        if self._streams.out.isatty():
            self._streams.out.write(printable_lines(content.decode("utf-8", "backslashreplace")))
        elif isinstance(self._streams.out, Output):
            self._streams.out.put(content)
        else:
            self._streams.out.write(content.decode())

    def _line(self, text: str, colour: str = "") -> None:
        """Show a printable line."""
        if not self._json and self._verbosity >= 0:
            self._streams.out.write(_paint(text, colour, colour=bool(colour) and self._streams.colour_out) + "\n")

    def table(self, columns: Mapping[str, str], rows: Iterable[Mapping[str, Any]]) -> None:
        """Show a table as aligned text, one line per row.

        If it is too wide, days until a date are left out, and then cells are folded.

        Args:
            columns: the member of the rows that each column has, by its title.
            rows: data as for ``--json``; what is missing, none or empty is shown as ``-``.
        """
        if self._json or self._verbosity < 0:
            return
        lines = [[*columns], *([_cell(row.get(member)) for member in columns.values()] for row in rows)]
        room = (self._streams.width or _WIDTH) - 2 * (len(columns) - 1)
        if sum(_widths(lines)) > room:
            lines = [[re.sub(r" \([0-9]+ d\)$", "", cell) for cell in line] for line in lines]
        widths = _narrowed(lines, _widths(lines), room, breaks=self._streams.width is not None)
        for index, line in enumerate(lines):
            for part in itertools.zip_longest(*map(_folded, line, widths), fillvalue=""):
                text = "  ".join(map(str.ljust, part, widths)).rstrip()
                self._line(text, "1" if index == 0 else "")

    def _steps(self, report: Report) -> None:
        told = [step for step in report.steps if step.action is not Action.UNCHANGED or self._verbosity > 0]
        for step, number in self._rolled_up(_in_order(told, "stage", "package")):
            name = step.package or step.detail
            if number > 1:
                name = f"{number:,} {'packages' if step.package else 'items'}, e.g. {name}"
            detail = f"  ({step.detail})" if step.detail and step.package else ""
            label = _paint(f"{step.action:9}", "32", colour=self._streams.colour_out)
            self._line(f"{label} {one_line(f'{step.stage:11} {name}{detail}')}")
            if self._verbosity > 0 and report.workspace:
                for change in step.changes:
                    for file in change.written:
                        self.line(f"            {report.workspace.shown(f'{change.folder}/{file}')}")
                    for file in change.removed:
                        self.line(f"            {report.workspace.shown(f'{change.folder}/{file}')} (removed)")
        if report.steps:
            if not any(step.writes() for step in report.steps):
                packages = {each.package for each in report.steps if each.package and each.stage != "authorities"}
                what = quantity(len(packages), "package") if packages else "everything"
                self.line(f"nothing to do: {what} up to date")
            else:
                counts = Counter(str(step.action) for step in report.steps)
                would = "would be " if report.dry_run else ""
                self.line(would + ", ".join(f"{counts[a]:,} {a}" for a in map(str, Action) if counts[a]))
            # The total size of the built documents, if it differs from that of their plain form.
            sizes = [size for step in report.steps if step.action is not Action.UNCHANGED for size in step.sizes]
            now, plain = sum(size.bytes for size in sizes), sum(size.plain_bytes for size in sizes)
            if now != plain:
                files = f"{', '.join(sorted({size.file for size in sizes}))} of {quantity(len(sizes), 'package')}"
                self.line(f"{files}: {now:,} bytes, {plain:,} in plain form ({(now - plain) / plain:+.0%})")

    def _say_err(self, text: str) -> None:
        self._streams.err.write(f"{text}\n")
        self._streams.err.flush()


def _in_order(items: Sequence[_T], kind: str, name: str) -> list[_T]:
    """Return items with neighbours of one kind in the order of their names: r2 before r10.

    Those that are not sorted by the characters of their names are in another order, e.g. of lines, and stay in it.
    """
    ordered: list[_T] = []
    names = attrgetter(name)
    groups: Iterable[tuple[Any, Iterator[_T]]] = itertools.groupby(items, attrgetter(kind))
    for _, group in groups:
        own = list(group)
        is_sorted = all(names(one) <= names(other) for one, other in itertools.pairwise(own))
        ordered += sorted(own, key=lambda each: natural_order(names(each))) if is_sorted and len(own) > 1 else own
    return ordered


def _cell(value: Any) -> str:
    """Return a value in a table: a moment as its day, several values with blanks between them."""
    match value:
        case None | "" | () | []:
            return "-"
        case bool():
            return "yes" if value else "no"
        case datetime():
            return f"{value:%Y-%m-%d}"
        case tuple() | list():
            return " ".join(map(_cell, value))
    return one_line(str(value))


_WIDTH, _NARROWEST = 80, 8
"""Columns of a table that goes to no terminal; columns of a table are not made narrower than the second."""


def _widths(lines: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(len, column)) for column in zip(*lines, strict=True)]


def _narrowed(lines: Sequence[Sequence[str]], widths: Sequence[int], room: int, *, breaks: bool) -> list[int]:
    """Return smaller widths of columns: the widest give way, down to their longest word, or below."""
    narrowed = [*widths]
    least = [max(len(word) for cell in column for word in cell.split(" ")) for column in zip(*lines, strict=True)]
    if breaks and sum(least) > room:
        least = [min(_NARROWEST, width) for width in widths]
    while sum(narrowed) > room and narrowed != least:
        index = max(range(len(narrowed)), key=lambda index: (narrowed[index] > least[index], narrowed[index]))
        narrowed[index] -= 1
    return narrowed


def _folded(cell: str, width: int) -> Iterator[str]:
    """Yield the lines of a cell: it is folded at blanks, else after slashes, and only in want of both elsewhere."""
    while len(cell) > width:
        blank, slash = cell.rfind(" ", 0, width + 1), cell.rfind("/", 0, width) + 1
        if blank > 0 and len(cell[blank + 1 :].partition(" ")[0]) <= width:
            cut = blank
        else:
            cut = slash if slash > width // 2 else width
        yield cell[:cut].rstrip()
        cell = cell[cut:].lstrip()
    yield cell


def _others(number: int) -> str:
    """Return how many lines a line stands for."""
    return f" (1 of {number:,} alike; -v shows all)" if number > 1 else ""


def _paint(text: str, code: str, *, colour: bool) -> str:
    return f"\033[{code}m{text}\033[0m" if colour else text


def _bar(streams: Streams) -> Any:
    """Return a progress bar."""
    from rich.console import Console as RichConsole  # noqa: PLC0415 - slow, and only for long work
    from rich.progress import Progress  # noqa: PLC0415

    console = RichConsole(file=streams.err, force_terminal=True, no_color=not streams.colour_err)
    return Progress(console=console, transient=True)
