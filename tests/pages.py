# SPDX-License-Identifier: Apache-2.0
"""Pages that are followed as a reader does: files are saved, commands are typed, and what they print is compared.

CONTRIBUTING.md ("Documentation") describes the form of such a page. ``python -m tests.pages PAGE…`` follows pages and
writes what was printed into them.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Self

from tests.stand_ins import STAND_INS

CHECKOUT = Path(__file__).resolve().parent.parent
HOME = "~"
"""What a page shows for the folder in which its reader begins."""
CLOCK = datetime.fromisoformat("2026-11-21T00:00:00Z")
"""When a page is read, unless it says otherwise."""
NOW = "<!-- clock: now -->"
"""What a page says that asks real DDS software, which reads the clock of the machine: then dates are masked."""
LONGEST = 240
"""How long one command may take, in seconds."""
NOT_RUN = re.compile(r" {2,}# needs (ROS 2|the network|root|Docker)\b")
"""How a page marks a command that the suite cannot run."""

_FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_COMMENT = re.compile(r"<!-- (clock|starts where): (\S+?)(?: ends)? -->")
_PLACE = re.compile(r"(save this as|append this to|change)\s+`([^`]+)`", re.IGNORECASE)
_ENDED = "--ended--"
_MASKS = (
    (re.compile(r"\b[0-9a-fA-F]{2}(:[0-9a-fA-F]{2}){7,}\b"), "HEX"),
    (re.compile(r"\b(?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{8,}\b"), "HEX"),
    (re.compile(r"\b(CN|OU) = "), r"\1="),
    (re.compile(r"(?<=\S) {2,}"), "  "),
    (re.compile(r"\b[0-9]{12,}\b"), "NUMBER"),
    (re.compile(r"\b[0-9]+(\.[0-9]+)? (ms|s|seconds?)\b"), "TIME"),
    (re.compile(r"\b[Kk]eymint(,? version)? [0-9]+\.[0-9]+[0-9a-z.+]*"), "Keymint VERSION"),
    (re.compile(r"(?<![-\w.])[0-9]+\.[0-9]+\.[0-9]+(?![-\w.])"), "VERSION"),
)
"""What differs with key, speed or version.

That is digests, serials, long numbers, durations, versions, the width of columns, and how OpenSSL writes names.
"""


@dataclass(frozen=True)
class Step:
    """One thing that the reader of a page does.

    Attributes:
        kind: ``run``, ``save``, ``append``, ``change``, ``clock`` or ``starts``.
        what: the command, the name of the file, the time or the page.
        content: what the command prints, or the text of the file.
        line: where it stands in the page.
        span: where ``content`` stands in the text of the page.
    """

    kind: str
    what: str
    content: str
    line: int
    span: tuple[int, int] = (0, 0)

    @property
    def not_run(self) -> bool:
        """Whether this command needs what the suite does not have."""
        return self.kind == "run" and NOT_RUN.search(self.what) is not None


def steps_of(text: str) -> list[Step]:
    """Return what a page tells its reader to do, in its order."""
    steps: list[tuple[int, Step]] = []
    end = 0
    for block in _FENCE.finditer(text):
        before = text[end : block.start()]
        steps += [
            (end + each.start(), Step(each[1].split()[0], each[2], "", _line(text, end + each.start())))
            for each in _COMMENT.finditer(before)
        ]
        paragraph = before.rstrip().rpartition("\n\n")[2]
        place = _PLACE.search(paragraph) if paragraph.endswith(":") else None
        if block[1] == "console":
            steps += [(step.span[0], step) for step in _commands(text, block.start(2), block.end(2))]
        elif place:
            kind = place[1].lower().split()[0]
            assert kind != "change" or block[1] == "diff", f"line {_line(text, block.start())}: a change is a diff"
            steps.append((block.start(), Step(kind, place[2], block[2], _line(text, block.start()))))
        end = block.end()
    return [step for _, step in sorted(steps, key=lambda each: each[0])]


def _line(text: str, at: int) -> int:
    return text.count("\n", 0, at) + 1


def _commands(text: str, start: int, end: int) -> Iterator[Step]:
    """Yield the commands of a console block: a line with ``$``, lines with ``>`` that continue it, and the output."""
    for part in re.finditer(r"^\$ (.*\n(?:> .*\n)*)((?:(?!\$ ).*\n)*)", text[start:end], re.MULTILINE):
        command = part[1].rstrip("\n").replace("\n> ", "\n")
        at = start + part.start(2), start + part.end(2)
        yield Step("run", command, part[2], _line(text, start + part.start()), at)


def masked(text: str, page: str = "") -> str:
    """Return text with the same word for whatever differs with key, speed or version.

    Arguments:
        text: what was printed, or is shown.
        page: the text of the page.
    """
    for pattern, word in (*_MASKS, *(_DATES if NOW in page else ())):
        text = pattern.sub(word, text)
    return text


def is_shown(printed: str, shown: str, page: str = "") -> bool:
    """Tell whether a page shows what was printed: ``…`` stands for a part of a line, or alone for several lines."""
    pattern = re.escape(masked(shown, page))
    pattern = re.sub(r"^…\\\n", "(.*\\n)*?", pattern, flags=re.MULTILINE).replace("…", ".*")
    return re.fullmatch(pattern, masked(printed, page)) is not None


_DATES = ((re.compile(r"\b20[0-9]{2}-[0-9]{2}-[0-9]{2}(T[0-9:]+Z)?( \([0-9]+ d\))?"), "DATE"),)


class Reader:
    """Somebody who follows a page in a shell, beginning in an empty folder.

    Arguments:
        folder: the empty folder.
        stand_ins: by a command that needs what is not here, one that does the same.
    """

    def __init__(self, folder: Path, stand_ins: Mapping[str, str] | None = None) -> None:
        self._start = self._folder = folder
        self._stand_ins = stand_ins or {}
        self._code = 0
        programs = [str(Path(sys.executable).parent), "/usr/local/bin", "/usr/bin", "/bin", "/usr/sbin", "/sbin"]
        self._shell = subprocess.Popen(
            ["/bin/bash", "--norc", "--noprofile"],
            cwd=folder,
            env={
                "PATH": os.pathsep.join(programs),
                "HOME": str(folder),
                "LANG": "C.UTF-8",
                "COLUMNS": "120",
                "PYTHONUNBUFFERED": "1",
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._clock(CLOCK)

    def __enter__(self) -> Self:
        """Return this reader."""
        return self

    def __exit__(self, *_error: object) -> None:
        """End the shell."""
        os.killpg(self._shell.pid, signal.SIGKILL)
        self._shell.communicate()

    def follow(self, page: Path) -> Iterator[tuple[Step, str]]:
        """Do what a page says, one step after the other.

        Arguments:
            page: a Markdown page.

        Yields:
            Each command that was run, with what it printed.

        Raises:
            AssertionError: a command fails and the page does not show that it does; a change does not fit.
        """
        steps = steps_of(page.read_text())
        for step, following in zip(steps, [*steps[1:], None], strict=True):
            if step.kind == "run" and not step.not_run:
                output = self.run(step.what)
                told = following is not None and following.what == "echo $?"
                refused = re.search(r"^(error: |.*: error: )", step.content, re.MULTILINE)
                assert self._code == 0 or told or refused, f"{page}:{step.line}: exit code {self._code}\n{output}"
                yield step, output
            else:
                self._do(step, page)

    def _do(self, step: Step, page: Path) -> None:
        """Do what is no command that runs here."""
        file = self._folder / step.what
        match step.kind:
            case "starts":
                list(self.follow((page.parent / step.what).resolve()))
            case "clock":
                self._clock(None if step.what == "now" else datetime.fromisoformat(step.what))
            case "save":
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(step.content)
            case "append":
                file.write_text(file.read_text() + step.content)
            case "change":
                file.write_text(changed(file.read_text(), step.content, f"{page}:{step.line}"))
            case "run":
                stand_in = self._stand_ins.get(NOT_RUN.split(step.what)[0].strip())
                if stand_in:
                    said = self.run(stand_in)
                    assert self._code == 0, f"{page}:{step.line}: what stands in for this fails: {said}"

    def _clock(self, now: datetime | None) -> None:
        self.run(f"export SOURCE_DATE_EPOCH={int(now.timestamp())}" if now else "unset SOURCE_DATE_EPOCH")

    def run(self, command: str) -> str:
        """Type a command, and return what it prints, with the names of folders that a page shows."""
        stdin, stdout = self._shell.stdin, self._shell.stdout
        assert stdin is not None
        assert stdout is not None
        stdin.write(
            f"(exit {self._code})\neval {shlex.quote(command)} </dev/null\nprintf '\\n{_ENDED} %d %s\\n' $? \"$PWD\"\n"
        )
        stdin.flush()
        alarm = threading.Timer(LONGEST, self._shell.kill)
        alarm.start()
        lines: list[str] = []
        for line in stdout:
            if line.startswith(_ENDED):
                _, code, folder = line.rstrip("\n").split(" ", 2)
                break
            lines.append(line)
        else:
            raise AssertionError(f"the shell ended in: {command}\n{''.join(lines)}")
        alarm.cancel()
        self._code, self._folder = int(code), Path(folder)
        output = "".join(lines).removesuffix("\n")
        return output.replace(str(self._start), HOME)


def changed(text: str, diff: str, where: str) -> str:
    """Return text with a change that a page shows as a diff without numbers of lines.

    Arguments:
        text: content of the file.
        diff: its lines begin with ``-``, ``+`` or a blank; ``@@`` separates parts for different places.
        where: the place of the diff, for messages.

    Raises:
        AssertionError: the old lines are not there exactly once.
    """
    for hunk in re.split(r"^@@.*\n", diff, flags=re.MULTILINE):
        lines = [line if line.strip() else " \n" for line in hunk.splitlines(keepends=True)]
        old = "".join(line[1:] for line in lines if line[0] in "- ")
        new = "".join(line[1:] for line in lines if line[0] in "+ ")
        assert text.count(old) == 1, f"{where}: {text.count(old)} times in the file:\n{old}"
        text = text.replace(old, new)
    return text


def rewritten(page: Path, printed: list[tuple[Step, str]]) -> str:
    """Return the text of a page with what its commands printed; what it shows already stays as it is."""
    text = page.read_text()
    for step, output in sorted(printed, key=lambda each: each[0].span, reverse=True):
        if not is_shown(output, step.content, text):
            text = text[: step.span[0]] + output + text[step.span[1] :]
    return text


def drawings(page: Path, folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield each picture of a page with the file of the same name that its reader drew, if there is one.

    Arguments:
        page: a Markdown page.
        folder: where its reader began.
    """
    for target in re.findall(r"!\[[^\]]*\]\(([^)\s]+\.svg)\)", page.read_text()):
        for drawn in folder.rglob(Path(target).name):
            yield page.parent / target, drawn


def main() -> None:
    """Follow pages that the command line names, and write into them what was printed."""
    for name in sys.argv[1:]:
        folder, page = tempfile.mkdtemp(prefix="pages-"), Path(name)
        printed: list[tuple[Step, str]] = []
        try:
            with Reader(Path(folder), STAND_INS) as reader:
                printed.extend(reader.follow(page))
        finally:
            page.write_text(rewritten(page, printed))
            for picture, drawn in drawings(page, Path(folder)):
                before = picture.read_text() if picture.exists() else ""
                if masked(drawn.read_text(), NOW) != masked(before, NOW):
                    shutil.copyfile(drawn, picture)
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
