# SPDX-License-Identifier: Apache-2.0
"""Do what the help of an error says, and see whether it brings progress."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from keymint import cli
from tests.effort import FULL

Run = Callable[[Sequence[str], Path], "tuple[int, str]"]
"""Runs a command line in a folder; returns its exit code and what it printed to standard output."""
Outcome = tuple[str, tuple[str, ...]]
"""What came of it, and the command lines and errors on the way."""

COMMAND = re.compile(r"'keymint ([a-z][^']*)'")
LOOKING = frozenset({
    "check", "completion", "diff", "fmt", "graph", "issued", "lint", "plugins", "prove", "query", "status", "test",
    "transports", "verify", "why",
})  # fmt: skip
"""Verbs that advice names to look at something. They need not change the outcome."""
SAYS = re.compile(r" (and 'keymint [^']*' )?(says?|shows?|lists?|names?|tells?|reads?|prints?)\b")
"""After a command: it only says something."""
FOLLOWS = os.environ.get("KEYMINT_ADVICE", "1" if FULL else "0") == "1"
"""Whether the advice of each error that a test meets is followed: in ``make test-full``, or by itself."""
DEEPEST = 6
"""Pieces of advice that lead to one another; a circle is longer than any chain that leads somewhere."""


@dataclass(frozen=True)
class Advice:
    """What the help of an error says to do.

    Attributes:
        by_hand: what comes before the first command: an action of the user's, or nothing.
        commands: the command lines of the first alternative, in order, without ``keymint``.
    """

    by_hand: str
    commands: tuple[tuple[str, ...], ...]
    only_looks: bool


def advice_in(text: str) -> Advice | None:
    """Return the first alternative with a command that a help names; None without one."""
    for alternative in re.split(r";|, or | or (?=')", text):
        found = COMMAND.findall(alternative)
        if found:
            before, *_, after = COMMAND.split(alternative)
            return Advice(before.strip(), tuple(tuple(shlex.split(each)) for each in found), bool(SAYS.match(after)))
    return None


@dataclass(frozen=True)
class Followed:
    """What became of an error whose advice was followed.

    Attributes:
        code: the error's.
        outcome: ``progress``, ``looked`` (the command only shows something), ``by hand`` (the user does something), or
            what is wrong.
        path: the command lines and errors on the way.
    """

    code: str
    outcome: str
    path: tuple[str, ...]

    @property
    def is_wrong(self) -> bool:
        return self.outcome not in {"progress", "looked", "by hand"}


def errors_of(printed: str) -> list[dict[str, Any]]:
    """Return the errors of a report in JSON, then its warnings."""
    found = [each for each in json.loads(printed)["diagnostics"] if each["severity"] != "note"]
    return sorted(found, key=lambda each: str(each["severity"]))


def key_of(error: Mapping[str, Any]) -> str:
    """Return what makes an error the same: its code, place and message, without numbers that vary."""
    return f"{error['code']} {error['file'] or ''}: {re.sub(r'[0-9a-f]{8,}', 'X', error['message'])}"


def complete(command: Sequence[str], line: Sequence[str]) -> list[str]:
    """Return an advised command line for the workspace of the line that failed, with a report in JSON."""
    found = [*command]
    for at, word in enumerate(line[:-1]):
        if word in {"-w", "--workspace"} and "-w" not in command:
            found += ["-w", line[at + 1]]
    place = found.index("--") if "--" in found else len(found)
    return [*found[:place], "--json", *found[place:]]


def state_of(folder: Path) -> str:
    """Return a digest of all files below a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        digest.update(os.fsencode(path))
        if path.is_symlink():
            digest.update(os.fsencode(path.readlink()))
        elif path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def follow(line: Sequence[str], folder: Path, run: Run, inner: str = ".") -> Iterator[Followed]:
    """Follow the advice of the errors of a command line, each in a copy of its folder.

    Args:
        line: the command line that failed, without ``--json``.
        folder: where it ran; it stays as it is.
        run: runs a command line in a folder.
        inner: the folder in it to which the paths of errors are relative.

    Yields:
        What became of each error whose help names a command.
    """
    seen = set()
    for error in errors_of(run(complete(line, ()), folder / inner)[1]):
        advice = advice_in(error["help"])
        if advice is None or (error["code"], advice.by_hand) in seen:
            continue
        seen.add((error["code"], advice.by_hand))
        copy = folder.with_name(f"{folder.name}-followed")
        subprocess.run(["cp", "-a", "--reflink=auto", str(folder), str(copy)], check=True)  # pipes as well
        try:
            moved = [word.replace(str(folder), str(copy)) for word in line]
            wanted = key_of(error).replace(str(folder), str(copy))
            yield Followed(error["code"], *_followed(moved, copy / inner, run, wanted, ()))
        finally:
            shutil.rmtree(copy, ignore_errors=True)


def _followed(  # noqa: PLR0911 - each way in which it ends
    line: Sequence[str], folder: Path, run: Run, wanted: str, path: tuple[str, ...]
) -> Outcome:
    """Follow the advice of one error of a command line, and of the errors on the way."""
    found = next((each for each in errors_of(run(complete(line, ()), folder)[1]) if key_of(each) == wanted), None)
    if found is None:
        return "progress", (*path, f"$ {shlex.join(line)}: not that error any more")
    before = state_of(folder)
    here = f"$ {shlex.join(line)}: {wanted} ({found['help']})"
    path = (*path, here)
    if (here + before) in path:
        return "a circle", path
    path = (*path, here + before)
    advice = advice_in(found["help"])
    if advice is None:
        return "by hand", path
    if advice.by_hand.startswith("remove it") and found["file"]:
        (folder / found["file"]).unlink()
    elif advice.by_hand not in {"", "run", "first run"}:
        return "by hand", path
    for command in advice.commands:
        if any(re.fullmatch(r"[A-Z]+|.*…", word) for word in command):
            return "by hand", path
        if advice.only_looks or command[0] in LOOKING:
            run(complete(command, line), folder)
            return "looked", path
        outcome, path = _run(command, line, folder, run, path)
        if outcome != "progress":
            return outcome, path
    left = {key_of(each) for each in errors_of(run(complete(line, ()), folder)[1])}
    return ("no progress" if wanted in left and state_of(folder) == before else "progress"), path


def _run(command: Sequence[str], line: Sequence[str], folder: Path, run: Run, path: tuple[str, ...]) -> Outcome:
    """Run an advised command until it succeeds; do what its own errors advise."""
    for _ in range(DEEPEST):
        told = complete(command, line)
        status, printed = run(told, folder)
        path = (*path, f"$ {shlex.join(told)}: {status}")
        errors = errors_of(printed)
        if status == 0 or (status == 3 and not errors):
            return "progress", path
        if not errors:
            return f"'{command[0]}' ends with {status} and no error", path
        outcome, path = _followed([word for word in told if word != "--json"], folder, run, key_of(errors[0]), path)
        if outcome != "progress":
            return outcome, path
    return "too many steps", path


def once(line: Sequence[str], folder: Path) -> tuple[int, str]:
    """Run a command line in this process, in a folder."""
    out = io.StringIO()
    before = Path.cwd()
    os.chdir(folder)
    umask = os.umask(0o022)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
            code = cli.main([*line])
    finally:
        os.umask(umask)
        os.chdir(before)
    return code, out.getvalue()


def in_a_fork(line: Sequence[str], folder: Path, place: Path) -> list[str]:
    """Follow the advice of a command line that failed in a test, which does not notice it.

    Args:
        line: the command line.
        folder: the folder of the test.
        place: where it ran; the advice of a run elsewhere is not followed.

    Returns:
        What is wrong with the advice, a text for each error.
    """
    if not place.is_relative_to(folder) or any(word.startswith("/") and str(folder) not in word for word in line):
        return []
    plain = [word for word in line if word not in {"--json", "-q", "-v"}]
    told = folder.with_name(f"{folder.name}-advice")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the fork runs one thread, and ends with it
        child = os.fork()
    if not child:
        found = ["the run ended before its advice was followed"]
        try:
            results = follow(plain, folder, once, str(place.relative_to(folder)))
            found = ["\n".join((each.code, each.outcome, *each.path)) for each in results if each.is_wrong]
        except BaseException as error:  # noqa: BLE001 - the test that goes on reports it
            found = [f"{shlex.join(line)}: {error!r}"]
        finally:
            told.write_text(json.dumps(found))
            os._exit(0)
    os.waitpid(child, 0)
    try:
        return list(json.loads(told.read_text()))
    finally:
        told.unlink()
