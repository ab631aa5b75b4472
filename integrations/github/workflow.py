# SPDX-License-Identifier: Apache-2.0
"""What a step of a GitHub workflow says to the runner: commands in the log, outputs and the summary of the job.

Names of files and branches, and texts of policies, come from whoever opens a pull request. None becomes a command: see
https://docs.github.com/actions/reference/workflows-and-actions/workflow-commands.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Mapping
from pathlib import Path

LONGEST_SUMMARY = 1_000_000
"""Bytes of a summary; GitHub takes 1 MiB of a step."""
_LEVELS = {"error": "error", "warning": "warning", "note": "notice"}


def annotation(severity: str, message: str, file: str | None = None, line: int | None = None) -> str:
    """Return the command that annotates a line of a file.

    Args:
        severity: ``error``, ``warning`` or ``note``.
        message: any text.
        file: path relative to the repository, or None.
        line: line number from 1, or None.
    """
    places = {"file": file, "line": line}
    properties = ",".join(f"{name}={_property(str(value))}" for name, value in places.items() if value is not None)
    return f"::{_LEVELS[severity]}{f' {properties}' if properties else ''}::{_data(message)}"


def shown(text: str) -> str:
    """Return text for the log in which the runner finds no commands."""
    token = secrets.token_hex(16)
    return f"::stop-commands::{token}\n{text.rstrip()}\n::{token}::"


def outputs(values: Mapping[str, str]) -> str:
    """Return the lines for the file of outputs; values may have several lines."""
    end = f"end_{secrets.token_hex(16)}"
    return "".join(f"{name}<<{end}\n{value}\n{end}\n" for name, value in values.items())


def append(path: str, text: str) -> None:
    """Append text to a file that the runner names; does nothing without a name."""
    if path:
        with Path(path).open("a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)


def fenced(text: str) -> str:
    """Return text as a block of code in Markdown (CommonMark 0.31.2, 4.5); no text ends the block."""
    fence = "```"
    while fence in text:
        fence += "`"
    return f"{fence}text\n{text.rstrip()}\n{fence}"


def cut(text: str, most: int, note: str) -> str:
    """Return text of at most so many bytes, with a note at its end if something is missing; no line is cut."""
    if len(text.encode(errors="replace")) <= most:
        return text
    kept: list[str] = []
    size, fence = len(note.encode()) + 4, ""
    for line in text.split("\n"):
        size += len(line.encode(errors="replace")) + 1
        opened = re.match("`{3,}", line)
        if opened and not fence:
            fence = opened[0]
            size += len(fence) + 1
        elif line == fence:
            fence = ""
        if size > most:
            break
        kept.append(line)
    return "\n".join([*kept, *([fence] if fence else []), "", note, ""])


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
