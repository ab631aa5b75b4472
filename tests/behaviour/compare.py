# SPDX-License-Identifier: Apache-2.0
"""Differences between two records, by their kind."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

KINDS = ("case", "step", "exit code", "code", "member removed", "member added", "member", "output", "file", "mode",
         "document")  # fmt: skip
"""Kinds of differences, in the order in which they are printed. An added member of JSON is one as well."""


@dataclass(frozen=True)
class Difference:
    """One difference.

    Attributes:
        kind: one of :data:`KINDS`.
        where: the case, the number of the step and its command.
        what: path of the member or file, if there is one.
        lines: what it was and what it is.
    """

    kind: str
    where: str
    what: str
    lines: tuple[str, ...]


def differences(old: Path, new: Path) -> list[Difference]:
    """Return the differences between two folders of records."""
    mine, other = ({path.stem: path for path in folder.glob("*.json")} for folder in (old, new))
    found = [Difference("case", name, "", ("-" if name in mine else "+",)) for name in mine.keys() ^ other.keys()]
    for name in sorted(mine.keys() & other.keys()):
        found += _of_case(name, json.loads(mine[name].read_text()), json.loads(other[name].read_text()))
    if not mine and not other:
        raise ValueError(f"no records in {old} and {new}")
    return sorted(found, key=lambda each: (KINDS.index(each.kind), each.where, each.what))


def report(found: list[Difference], most: int = 20) -> Iterator[str]:
    """Yield the lines of a report: counts by kind, then the first differences of each kind."""
    for kind in KINDS:
        same = [each for each in found if each.kind == kind]
        if same:
            yield f"== {kind}: {len(same)} in {len({each.where.partition(' ')[0] for each in same})} cases"
        for each in same[:most]:
            yield f"{each.where}{f': {each.what}' if each.what else ''}"
            yield from (f"    {line}" for line in each.lines[:12])
        if len(same) > most:
            yield f"... and {len(same) - most} more"
    yield f"{len(found)} differences"


def _of_case(name: str, old: list[Any], new: list[Any]) -> Iterator[Difference]:
    for number, (one, two) in enumerate(zip(old, new, strict=False)):
        where = " ".join([f"{name} #{number}", one["label"], "keymint", *one["argv"]])
        if (one["argv"], one["label"]) != (two["argv"], two["label"]):
            yield Difference("step", where, "", _pair(one["argv"], two["argv"]))
            return
        yield from _of_step(where, one, two)
    if len(old) != len(new):
        yield Difference("step", name, "", _pair(len(old), len(new)))


def _of_step(where: str, one: dict[str, Any], two: dict[str, Any]) -> Iterator[Difference]:
    if one["exit"] != two["exit"]:
        yield Difference("exit code", where, "", _pair(one["exit"], two["exit"]))
    if one.get("codes") != two.get("codes"):
        yield Difference("code", where, "", _unified(one.get("codes", []), two.get("codes", [])))
    mine, other = dict(_members(one.get("json"), "")), dict(_members(two.get("json"), ""))
    for path in sorted(mine.keys() | other.keys()):
        if path not in other:
            yield Difference("member removed", where, path, (f"-{mine[path]}",))
        elif path not in mine:
            yield Difference("member added", where, path, (f"+{other[path]}",))
        elif mine[path] != other[path]:
            yield Difference("member", where, path, _pair(mine[path], other[path]))
    for stream in ("out", "err"):
        if one.get(stream, []) != two.get(stream, []):
            yield Difference("output", where, stream, _unified(one.get(stream, []), two.get(stream, [])))
    yield from _of_files(where, one.get("files", {}), two.get("files", {}))


def _of_files(where: str, one: dict[str, Any], two: dict[str, Any]) -> Iterator[Difference]:
    """Compare what a step did to files: an entry is None for a file that it removed."""
    for path in sorted(one.keys() | two.keys()):
        said = [("not touched" if path not in each else "removed") if not each.get(path) else "" for each in (one, two)]
        if any(said):
            if said[0] != said[1]:
                yield Difference("file", where, path, _pair(said[0] or "written", said[1] or "written"))
            continue
        mine, other = one[path], two[path]
        if mine["mode"] != other["mode"]:
            yield Difference("mode", where, path, _pair(mine["mode"], other["mode"]))
        rest = [{key: value for key, value in each.items() if key != "mode"} for each in (mine, other)]
        if rest[0] != rest[1]:
            yield Difference("document", where, path, _unified(*(_lines(each) for each in rest)))


def _members(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield all members of a document with their paths; lists and objects without members too."""
    if isinstance(value, dict) and value:
        for key, each in value.items():
            yield from _members(each, f"{path}.{key}")
    elif isinstance(value, list) and value:
        for number, each in enumerate(value):
            yield from _members(each, f"{path}[{number}]")
    elif path:
        yield path, value


def _lines(value: Any) -> list[str]:
    return json.dumps(value, indent=1, sort_keys=True).replace("\\n", "\n").splitlines()


def _pair(old: object, new: object) -> tuple[str, ...]:
    return f"-{old}", f"+{new}"


def _unified(old: list[str], new: list[str]) -> tuple[str, ...]:
    changed = difflib.unified_diff(old, new, n=0, lineterm="")
    return tuple(line for line in changed if not line.startswith(("---", "+++", "@@")))
