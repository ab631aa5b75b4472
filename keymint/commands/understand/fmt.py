# SPDX-License-Identifier: Apache-2.0
"""``keymint fmt``: bring policy files into their canonical form."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import unified_diff
from pathlib import Path
from typing import Any

from comarmor.text import quantity
from comarmor.values import Data, replace
from comarmor.xml.reader import looks_like_xml
from keymint.api import PolicyType
from keymint.command_line.named_files import read_input, replace_inputs, user_path
from keymint.command_line.verb import PATH, Report, Run, argument, findings_if, flag, verb
from keymint.errors import Defects, Diagnostic, KeymintError, Origin, usage_error
from keymint.view.tree import MAX_FILE
from keymint.workspace.policy_loading import foreign_policy
from keymint.workspace.workspace import Workspace

_STANDARD = Path("-")
_NO_NEWLINE = "\\ No newline at end of file\n"


class _Formatted(Data):
    """A file, as it is and in canonical form.

    Attributes:
        path: the file; ``-`` for standard input.
        name: its path as the user would type it.
        before: its content.
        after: its content in canonical form.
    """

    path: Path
    name: str
    before: bytes
    after: bytes


@verb(dry_run=True)
def fmt(
    run: Run,
    paths: tuple[Path, ...] = argument(nargs=-1, type=PATH, metavar="[PATH]..."),
    check: bool = flag(),
    as_diff: bool = flag("--diff"),
) -> Report:
    """Bring policies, files that they include, and policy tests into their canonical form.

    PATH is a file, a directory with all that is below it, a workspace, or - for standard input, which is written to
    standard output [the policies of the current workspace]. In directories, files that are not policies stay
    unchanged, and links and hidden files are skipped.

    A policy means the same afterwards, and keeps all its comments; docs/language.md has the rules. If a file has an
    error, none is changed.

    \b
    keymint fmt comarmor.d
    keymint fmt --check --diff comarmor.d     in CI: exit code 3 if a file would change

    Options:
        check: Write nothing; exit code 3 if a file is not in canonical form.
        as_diff: Write nothing; show what would change.
    """
    if _STANDARD in paths and len(paths) > 1:
        raise usage_error("- for standard input stands alone", "format files in another call")
    files, skipped = _formatted(run, paths)
    changed = [each for each in files if each.before != each.after]
    writes = not (check or as_diff or run.dry_run or _STANDARD in paths)
    if writes:
        replace_inputs(run, {each.path: (each.before, each.after) for each in changed})
    diff = b"".join(file_diff(each.name, each.before, each.after) for each in changed) if as_diff else None
    if diff:
        run.console.document(diff)
    if _STANDARD in paths and not check and diff is None:
        run.console.document(files[0].after)
    elif diff is None:
        if writes or run.dry_run:
            run.console.messages([f"{each.name} {'written' if writes else 'would be written'}" for each in changed])
        done = "reformatted" if writes else "to reformat"
        run.console.line(f"{quantity(len(changed), 'file')} {done}, {len(files) - len(changed)} unchanged")
    result: dict[str, Any] = {
        "files": [{"file": each.name, "changed": each.before != each.after} for each in files],
        "written": [each.name for each in changed] if writes else [],
        "diff": None if diff is None else diff.decode(errors="backslashreplace"),
        "text": files[0].after.decode() if _STANDARD in paths else None,
    }
    findings = [_finding(each) for each in changed] if check else []
    report = run.report(result, [*findings, *skipped], findings_if(findings), workspace=run.known_workspace)
    return replace(report, dry_run=not writes)


def _finding(file: _Formatted) -> Diagnostic:
    message = "the file is not in canonical form"
    help_ = "keymint fmt -" if file.path == _STANDARD else f"keymint fmt {file.name}"
    return Diagnostic.warning("format", message, Origin(file.name, first_difference(file.before, file.after)), help_)


def _formatted(run: Run, paths: Iterable[Path]) -> tuple[list[_Formatted], list[Diagnostic]]:
    """Return the files of some paths, and a note for each file that is left as it is.

    Raises:
        KeymintError: the errors of all files.
    """
    types = [*run.plugins.policy_types().values()]
    files: list[_Formatted] = []
    skipped: list[Diagnostic] = []
    defects = Defects()
    for path, is_named in _files(run, types, paths).items():
        name = run.typed(str(path))
        with defects:
            content = run.setting.read(MAX_FILE + 1) if path == _STANDARD else read_input(run, path)
            can_format = types if looks_like_xml(content) or not is_named else ()
            forms = (each.formatted(content, name) for each in can_format)
            after = next((form for form in forms if form is not None), None)
            if after is not None:
                files.append(_Formatted(path, name, content, after))
            elif is_named:
                raise _refused(run, path, name, content)
            else:
                note = "is no policy, nor a part or a test of one: left as it is"
                skipped.append(Diagnostic.note("format-skipped", note, Origin(name)))
    defects.require_none()
    if not files:
        if foreign := foreign_policy(run.plugins, [run.setting.cwd / path for path in paths]):
            raise foreign.refusal(run.typed(str(foreign.path)))
        shown = str(next(iter(paths), "."))
        help_ = "name a ComArmor file, or a directory with *.xml files"
        raise KeymintError("no policy was found", where=Origin(shown), help=help_, code="policy-empty")
    return files, skipped


def _refused(run: Run, path: Path, name: str, content: bytes) -> KeymintError:
    """Return the error for a file that no plugin can format, or that is not XML, as a table of rules."""
    foreign = foreign_policy(run.plugins, [run.setting.cwd / path])
    if not looks_like_xml(content):
        message = f"is {foreign.noun if foreign else 'not XML'}, and 'keymint fmt' is for policies in XML"
        help_ = "leave it out: 'keymint lint' checks it" if foreign else "name a ComArmor file, or leave it out"
    elif foreign:
        return foreign.refusal(name)
    else:
        message = "is no policy, nor a part or a test of one"
        help_ = "name a ComArmor file, whose root element is <profiles>, <profile>, a rule or <tests>"
    return KeymintError(message, where=Origin(name), help=help_, code="format-unknown")


def _files(run: Run, types: Sequence[PolicyType], paths: Iterable[Path]) -> Mapping[Path, bool]:
    """Return the files of some paths, each with whether it was named itself; each file once."""
    named: dict[Path, tuple[Path, bool]] = {}
    for path in tuple(paths) or (None,):
        for found, is_named in _found(run, types, path):
            resolved = found if found == _STANDARD else (run.setting.cwd / found).resolve()
            known, was_named = named.get(resolved, (found, False))
            named[resolved] = known, was_named or is_named
    return dict(named.values())


def _found(run: Run, types: Sequence[PolicyType], path: Path | None) -> Iterator[tuple[Path, bool]]:
    """Yield the files that a path stands for, each with whether it was named itself."""
    for place in (path,) if path is not None and not user_path(run, path).is_dir() else _places(run, path):
        if user_path(run, place).is_dir():
            yield from ((file, False) for each in types for file in each.written_files(place))
        else:
            yield place, True


def _places(run: Run, path: Path | None) -> Sequence[Path]:
    """Return a folder, or the files and folders of a workspace's policies."""
    workspace = run.workspace() if path is None else Workspace.at(run.setting.cwd / path, {}, run.setting.cwd)
    if path is not None and not workspace.exists():
        return (run.setting.cwd / path,)
    return tuple(source.path for source in run.inputs(workspace).session().profile.policies)


def file_diff(name: str, before: bytes, after: bytes) -> bytes:
    """Return what changes in a file, with three lines of context; empty for equal contents.

    Args:
        name: its path, relative to the folder where the difference can be applied with ``-p1``.
        before: its content.
        after: its new content.
    """
    old, new = f"a/{name.lstrip('/')}", f"b/{name.lstrip('/')}"
    lines = unified_diff(_lines(before), _lines(after), old, new)
    return "".join(line if line.endswith("\n") else f"{line}\n{_NO_NEWLINE}" for line in lines).encode(
        errors="surrogateescape"
    )


def first_difference(before: bytes, after: bytes) -> int:
    """Return the number of the first line that differs, from 1; 0 for equal contents."""
    if before == after:
        return 0
    pairs = zip(_lines(before), _lines(after), strict=False)
    return next(
        (number for number, (old, new) in enumerate(pairs, 1) if old != new),
        min(before.count(b"\n"), after.count(b"\n")) + 1,
    )


def _lines(content: bytes) -> list[str]:
    """Return lines with their line feeds; other characters that Python takes for line ends are part of a line."""
    return re.findall(r"[^\n]*\n|[^\n]+", content.decode(errors="surrogateescape"))
