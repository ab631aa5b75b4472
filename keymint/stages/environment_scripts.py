# SPDX-License-Identifier: Apache-2.0
"""Plan the scripts of a keystore, which export the environment variables of its processes: ``keystore.bash``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from keymint.api import EnvironmentVariable
from keymint.errors import Diagnostic, KeymintError
from keymint.host.shells import MARK, SHELLS, script, variable_values
from keymint.names import subject_of
from keymint.store.changes import Action, File, Step, folder_changes
from keymint.workspace.installed_enclaves import INSTALLED, files_in
from keymint.workspace.package_build_types import recorded_build_types
from keymint.workspace.session import Session


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
        if existing is None or is_ours(existing):
            files[name] = File(content)
        else:
            warnings.append(_kept(session, name, "is not from Keymint"))
    changes = folder_changes(session.tree, install, files)
    if not changes:
        return (), tuple(warnings)
    names = tuple(changes[0].files)
    action = Action.UPDATED if any(session.tree.read(install / name) for name in names) else Action.CREATED
    return (Step(INSTALLED, "", action, changes, ", ".join(names)),), tuple(warnings)


def is_ours(content: bytes) -> bool:
    """Tell whether Keymint wrote a script, which may have been edited since."""
    return content.startswith(MARK.encode())


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
