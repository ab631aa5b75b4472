# SPDX-License-Identifier: Apache-2.0
"""The environment variables of processes in the syntax of shells: for one process, or as scripts of a keystore.

A script (``keystore.bash``) finds the keystore by its own path, wherever it lies.
"""

from __future__ import annotations

import string
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from comarmor.values import Data
from keymint.api import EnvironmentVariable
from keymint.errors import Diagnostic, KeymintError
from keymint.names import subject_of
from keymint.store.changes import Action, File, Step, folder_changes
from keymint.workspace.installed_enclaves import INSTALLED, SCRIPT_MARK, files_in, is_script
from keymint.workspace.package_build_types import recorded_build_types
from keymint.workspace.session import Session

_COMMENT = f"{SCRIPT_MARK} Source this file: the processes of this shell use this keystore, wherever it lies."
_PLAIN = frozenset(f"{string.ascii_letters}{string.digits}_./:+-")
"""Characters that every shell reads as they are; at the begin of a word, only letters, digits and ``_./``."""
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
        if text and _PLAIN.issuperset(text) and text[0] not in ":+-":
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


def scripts(session: Session, build_types: Iterable[str]) -> Mapping[str, bytes]:
    """Return the scripts by path relative to the install space; none if no process needs a variable.

    Args:
        session: the workspace and its profile.
        build_types: names of the build types that the enclaves have.
    """
    distro, layout = session.profile.distro, session.profile.layout
    variables: dict[str, EnvironmentVariable] = {}
    for name in sorted(build_types):
        build_type = session.plugins.build_type(name)
        if layout in build_type.LAYOUTS:
            variables |= {each.name: each for each in build_type.keystore_variables(distro, layout)}
    if not variables:
        return {}
    # Colcon has scripts named setup, local_setup and package.
    return {f"keystore.{shell}": script(variables.values(), shell) for shell in SHELLS}


def plan_scripts(session: Session, build_types: Iterable[str]) -> tuple[tuple[Step, ...], tuple[Diagnostic, ...]]:
    """Plan the scripts; one that somebody else wrote stays, with a warning.

    Args:
        session: the workspace and its profile.
        build_types: names of the build types that the enclaves will have.

    Returns:
        The step, if something is written, and the warnings.
    """
    install = session.workspace.install
    files: dict[str, File] = {}
    warnings: list[Diagnostic] = []
    for name, content in scripts(session, build_types).items():
        try:
            existing = session.tree.read(install / name)
        except KeymintError as error:
            warnings += (_kept(session, name, each.message) for each in error.diagnostics)
            continue
        if existing is None or is_script(existing):
            files[name] = File(content)
        else:
            warnings.append(_kept(session, name, "is not from Keymint"))
    changes = folder_changes(session.tree, install, files)
    if not changes:
        return (), tuple(warnings)
    names = tuple(changes[0].files)
    action = Action.UPDATED if any(session.tree.read(install / name) for name in names) else Action.CREATED
    return (Step(INSTALLED, "", action, changes, ", ".join(names)),), tuple(warnings)


def enclave_environment(session: Session, name: str) -> Mapping[str, str]:
    """Return the environment variables of a process that uses an enclave, by name.

    Args:
        session: the workspace and its profile.
        name: an installed package.
    """
    distro, layout = session.profile.distro, session.profile.layout
    files = files_in(session, name)
    variables: dict[str, EnvironmentVariable] = {}
    for each in recorded_build_types(session, name):
        build_type = session.plugins.build_type(each, session.package_marker(name))
        found = build_type.enclave_variables(distro, layout, subject_of(name), files)
        variables |= {variable.name: variable for variable in found}
    return variable_values(variables.values(), session.workspace.install)


def _kept(session: Session, name: str, message: str) -> Diagnostic:
    return Diagnostic.warning(
        "script-foreign",
        f"{message}: no script is written there, by which shells find the keystore",
        session.workspace.origin(session.workspace.install / name),
        "rename it or remove it, and run 'keymint install'",
    )
