"""How refuted claims are reported: at the unsigned document where none is signed yet, and one cause in one line."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from comarmor.errors import Diagnostic
from keymint.plan.inputs import Inputs, LoadedProfile

_FIRST = b"<?xml"
"""How a document begins; what a signed file has before it are the headers of S/MIME."""


def unsigned(found: Diagnostic, planned: Inputs, loaded: LoadedProfile) -> Diagnostic:
    """Return a finding with places in the unsigned documents for those in the signed files that are only planned.

    Args:
        found: the finding; it names files of the enclave as if they lay in ``build/``.
        planned: the workspace as it will be.
        loaded: its profile.
    """
    name = found.subject.removeprefix("/")
    workspace = planned.workspace
    folder = workspace.shown(workspace.build / name)
    enclave = workspace.enclaves(loaded.profile.layout) / name

    def line(file: str, number: int) -> int:
        head, _, _ = (planned.tree.read(enclave / f"{file}.p7s") or b"").partition(_FIRST)
        return number - head.count(b"\n")

    def place(match: re.Match[str]) -> str:
        return f"{folder}/{match[1]}.xml:{line(match[1], int(match[2]))}"

    message = re.sub(re.escape(folder) + r"/(\w+)\.p7s:(\d+)", place, found.message)
    where = found.where
    if where and where.file.startswith(f"{folder}/") and where.file.endswith(".p7s"):
        file = where.file.removeprefix(f"{folder}/").removesuffix(".p7s")
        shown = f"{folder}/{file}.xml"
        where = replace(where, file=shown, line=line(file, where.line) if where.line else 0)
    return replace(found, message=message, where=where)


def alike(refused: Iterable[Diagnostic], shown: Callable[[str], str]) -> Iterator[Diagnostic]:
    """Yield findings; those that say the same of several packages, as their cause is one, once with the number.

    Args:
        refused: findings, each about a subject.
        shown: from the name of a package to the folder of its documents, as messages have it.
    """
    groups: dict[tuple[str, str, str], list[Diagnostic]] = {}
    for found in refused:
        folder = shown(found.subject.removeprefix("/"))
        text = found.message.removeprefix(found.subject).replace(f"{folder}/", "")
        place = str(found.where).removeprefix(f"{folder}/") if found.where else ""
        groups.setdefault((found.code, text, place), []).append(found)
    for group in groups.values():
        count = len({found.subject for found in group})
        yield group[0] if count == 1 else replace(group[0], message=f"{group[0].message} [{count} packages]")
