# SPDX-License-Identifier: Apache-2.0
"""The journal of a run that writes: what was asked for, and the names that change once everything is staged.

It is the mark of a running command. Before the first effect it has the intent; once all is staged and durable, also the
names that are about to change. So the next run finishes what became visible in part, and drops what did not.
"""

from __future__ import annotations

import itertools
import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from comarmor.values import Data, replace
from keymint.errors import Diagnostic, KeymintError
from keymint.names import subject_list, subject_of
from keymint.store.file_writing import check_component
from keymint.store.group_commit import commit, waiting_name
from keymint.store.open_folders import OpenFolders, Roots
from keymint.store.staged import Exchange
from keymint.view.file_reading import is_temporary
from keymint.view.stamps import digest, sealed_document, unsealed_document

MARK = "running"
"""Name of its file in the folder of records, which stays if the command is killed."""

VERSION = 1
_SHOWN = frozenset({"-v", "--verbose", "-q", "--quiet", "--json", "--yes"})
"""Options that change what a command shows, or whether it asks, and nothing else."""
_OUTPUTS = ("-o", "--output", "--with-key")
"""Options whose values are files that a command writes."""
_NAMING_FILES = frozenset(
    {"accept", "adopt", "authority", "discover", "fmt", "import", "init", "learn", "provision", "sign"}
)
"""Verbs whose arguments are files; those of all others are names, e.g. ``/`` or ``/opt``, which are no paths."""
_MOST_FILES = 100_000
"""Files of a folder whose size and time are compared."""


class Journal(Data):
    """What a run was asked for, and how far it came if it did not come to its end.

    Attributes:
        command: the command as it was typed.
        inputs: digest of its arguments, and of the files that they name; the same for the same command only.
        packages: the packages that it changes.
        exchanges: the names that it was about to change; empty if nothing was visible yet, or all of it is.
        finished: all that it was asked for is visible.
    """

    command: str = ""
    inputs: str = ""
    packages: tuple[str, ...] = ()
    exchanges: tuple[Exchange, ...] = ()
    finished: bool = False

    def outcome(self, intent: Journal) -> Diagnostic | None:
        """Return what became of the run, for the next one; None if that does all of it by itself.

        Args:
            intent: that of the next run.
        """
        if self.finished:
            message = f"'{self.command}' was interrupted; all that it was asked for is done now"
            message += f": {subject_list([*map(subject_of, self.packages)])}" if self.packages else ""
            help_ = "deploy what it changed in the install space"
        elif self.command and self.inputs != intent.inputs:
            message = f"'{self.command}' was interrupted before anything changed, and is dropped"
            help_ = "give it again if it is still wanted"
        else:
            return None
        return Diagnostic.warning("run-interrupted", message, None, help_)

    def dump(self, records: Path) -> bytes:
        """Return the journal as bytes; its paths are relative to the folder of records, so a workspace may be moved."""
        places = {folder: os.path.relpath(folder, records) for folder in {each.folder for each in self.exchanges}}
        rows = [
            (each.order, places[each.folder], each.name, each.staged, each.file, each.replaces,
             each.changed)
            for each in self.exchanges
        ]  # fmt: skip
        intent = (self.command, self.inputs, self.packages)
        return sealed_document({"version": VERSION, "intent": intent, "exchanges": rows, "finished": self.finished})


def intent_of(arguments: Sequence[str], folder: Path) -> Journal:
    """Return the journal of a command that did nothing yet.

    Args:
        arguments: those of the command line.
        folder: the current directory.
    """
    words = ["keymint", *(word for word in arguments if word not in _SHOWN)]
    parts = words[:2]
    if not _NAMING_FILES.intersection(parts):
        return Journal(shlex.join(words), digest(*words))
    for before, word in itertools.pairwise(words[1:]):
        path = folder / word.rpartition("=")[2]
        is_input = not before.startswith(_OUTPUTS) and not word.startswith(_OUTPUTS) and path.exists()
        parts += [str(path.resolve()), _digest(str(path)) or ""] if is_input else [word]
        if is_input and not before.startswith("-") and path.is_dir():
            inside = {each: each.lstat() for each in itertools.islice(path.rglob("*"), _MOST_FILES)}
            parts += sorted(f"{each} {status.st_size} {status.st_mtime_ns}" for each, status in inside.items())
    return Journal(shlex.join(words), digest(*parts))


def load(content: bytes, records: Path) -> Journal:
    """Return a journal; one that is damaged or of another version has nothing that could be finished.

    Args:
        content: result of :meth:`Journal.dump`.
        records: the folder of records.
    """
    document = unsealed_document(content, VERSION) or {}
    try:
        command, inputs, packages = document["intent"]
        exchanges = tuple(_exchange(records, *row) for row in document["exchanges"])
        names = tuple(map(str, packages))
        return Journal(str(command), str(inputs), names, exchanges, document["finished"])
    except (ValueError, KeyError, TypeError, KeymintError):
        return Journal()


def _exchange(
    records: Path, order: int, folder: str, name: str, staged: str | None, file: Any, replaces: Any, changed: Any
) -> Exchange:
    if staged is not None and not is_temporary(staged):
        raise ValueError
    for part in (name, *("/".join(changed).split("/") if changed else ()), *([staged] if staged else ())):
        check_component(part, folder)
    place = os.path.normpath(records / folder)
    return Exchange(int(order), place, str(name), staged, bool(file), bool(replaces), dict(changed))


def recover(journal: Journal, roots: Roots) -> Journal:
    """Finish a run that became visible in part; of one that did not, nothing is changed.

    Args:
        journal: what it was about to change.
        roots: the roots of the store.

    Returns:
        The journal without names that are about to change.

    Raises:
        KeymintError: the system refuses; it can be tried again.
    """
    exchanges = journal.exchanges
    for exchange in exchanges:
        # The name of a new folder for which the one in its place began to be moved away.
        waiting = waiting_name(exchange.staged) if exchange.staged and exchange.replaces else ""
        if waiting and os.path.lexists(f"{exchange.folder}/{waiting}"):  # it may be the only complete copy
            commit(roots, [replace(exchange, staged=waiting)], lambda _: None)
    finished = journal.finished or not (all(map(_is_pending, exchanges)) or any(map(_is_lost, exchanges)))
    if finished:
        for exchange in exchanges:
            if _is_pending(exchange):  # asked late, since one may contain another one
                commit(roots, [exchange], lambda _: None)
        with OpenFolders(roots, create=False) as folders:
            for folder in {each.folder for each in exchanges if os.path.isdir(each.folder)}:
                folders.sync(folder)
    return replace(journal, exchanges=(), finished=finished)


def _is_pending(exchange: Exchange) -> bool:
    """Tell whether a name is not changed yet, and can be."""
    place = f"{exchange.folder}/{exchange.name}"
    if exchange.staged is None:
        paths = [f"{place}/{path}" for path in exchange.changed] if exchange.replaces else [place]
        return any(map(os.path.lexists, paths))
    # After two names are exchanged, the former folder has the name of what was staged.
    return os.path.lexists(f"{exchange.folder}/{exchange.staged}") and (
        not exchange.replaces or any(_digest(f"{place}/{path}") != wanted for path, wanted in exchange.changed.items())
    )


def _is_lost(exchange: Exchange) -> bool:
    """Tell whether a new name is not there, and what was staged for it is gone: another workspace removed it."""
    names = (exchange.staged, exchange.name) if exchange.staged and not exchange.replaces else ()
    return bool(names) and not any(os.path.lexists(f"{exchange.folder}/{name}") for name in names)


def _digest(path: str) -> str | None:
    try:
        return digest(Path(path).read_bytes())
    except OSError:
        return None
