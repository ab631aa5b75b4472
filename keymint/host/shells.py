# SPDX-License-Identifier: Apache-2.0
"""Write environment variables in the syntax of shells: for one process, or as scripts that find their own folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from comarmor.text import lazy_regex
from comarmor.values import Data
from keymint.api import EnvironmentVariable

MARK = "# Written by Keymint."
"""The beginning of each script, by which it is recognised."""
_COMMENT = f"{MARK} Source this file: the processes of this shell use this keystore, wherever it lies."
_PLAIN = lazy_regex(r"[A-Za-z0-9_./][A-Za-z0-9_./:+-]*")
"""What every shell reads as it is."""
_FOLDER = "_keymint_keystore"


class Shell(Data):
    """The syntax of a shell; by default that of POSIX.

    Attributes:
        own_folder: lines that set a variable to the folder of the script; it is absolute, and links are resolved.
        export: the statement that exports a variable, with the fields ``name`` and ``value``.
        forget: lines that remove the variable with the folder.
        escapes: what stands for a character in single quotes.
    """

    own_folder: str
    export: str = "export {name}={value}"
    forget: str = f"unset {_FOLDER}\n"
    escapes: Mapping[str, str] = MappingProxyType({"'": "'\\''"})

    def quoted(self, text: str) -> str:
        """Return a text as one word of this shell, which stands for nothing but itself."""
        if _PLAIN.fullmatch(text):
            return text
        return f"'{''.join(self.escapes.get(character, character) for character in text)}'"


SHELLS: Mapping[str, Shell] = MappingProxyType(
    {
        "bash": Shell(
            f'{_FOLDER}="$(readlink -f -- "${{BASH_SOURCE[0]}}")" || return 1\n{_FOLDER}="${{{_FOLDER}%/*}}"\n'
        ),
        # %x would show control characters in place of them.
        "zsh": Shell(f'{_FOLDER}="${{${{${{funcsourcetrace[@]:0:1}}%:*}}:A:h}}"\n'),
        "fish": Shell(
            f"set -l {_FOLDER} (realpath -- (status filename | string collect) | string collect)\n"
            f"set {_FOLDER} (dirname -- ${_FOLDER} | string collect)\n",
            "set -gx {name} {value}",
            "",
            MappingProxyType({"'": "\\'", "\\": "\\\\"}),
        ),
    }
)
"""The shells by name, which is also the suffix of their scripts."""


def exports(values: Mapping[str, str], shell: str) -> str:
    """Return the lines that export variables, for ``eval``.

    Args:
        values: the values of the variables by name.
        shell: one of :data:`SHELLS`.
    """
    syntax = SHELLS[shell]
    return "".join(f"{syntax.export.format(name=name, value=syntax.quoted(value))}\n" for name, value in values.items())


def script(variables: Iterable[EnvironmentVariable], shell: str) -> bytes:
    """Return a script, to be sourced, that exports variables; it lies in the keystore, and finds it by its own path.

    Args:
        variables: the variables.
        shell: one of :data:`SHELLS`.
    """
    syntax = SHELLS[shell]
    lines = [f"{_COMMENT}\n", syntax.own_folder]
    for each in variables:
        if each.is_path:
            below = f"/{each.value}" if each.value else ""
            value = f'"${_FOLDER}"{syntax.quoted(below) if below else ""}'
        else:
            value = syntax.quoted(each.value)
        lines.append(f"{syntax.export.format(name=each.name, value=value)}\n")
    return "".join([*lines, syntax.forget]).encode()


def variable_values(variables: Iterable[EnvironmentVariable], keystore: Path) -> Mapping[str, str]:
    """Return the values of variables by name.

    Args:
        variables: the variables.
        keystore: absolute path of the keystore.
    """
    return {each.name: str(keystore / each.value) if each.is_path else each.value for each in variables}
