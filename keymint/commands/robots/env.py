# SPDX-License-Identifier: Apache-2.0
"""``keymint env``: the environment variables of a process that uses an enclave."""

from __future__ import annotations

import click

from comarmor.text import did_you_mean
from comarmor.values import replace
from keymint.command_line.verb import Report, Run, argument, option, verb
from keymint.errors import KeymintError, Severity
from keymint.names import package_name, subject_of
from keymint.stages.create import other_domain
from keymint.stages.environment_scripts import SHELLS, enclave_environment, exports
from keymint.stages.identities import missing_enclave
from keymint.workspace.installed_enclaves import enclave_names


@verb()
def env(
    run: Run,
    enclave: str = argument(),
    shell: str = option(type=click.Choice(tuple(SHELLS)), default="bash", show_default=True),
) -> Report:
    """Print the environment variables with which a process uses an installed ENCLAVE, and no other.

    \b
    bash, zsh:  eval "$(keymint env /robot1/talker)"
    fish:       keymint env --shell fish /robot1/talker | source

    An error prints 'false', so that eval fails: eval "$(keymint env …)" && ros2 run … starts nothing without security.

    After 'source install/keystore.bash' (.zsh, .fish), all processes of a shell find the keystore, each by the name
    of its enclave.

    Options:
        shell: Syntax to print.
    """
    session = run.inputs(run.workspace()).session()
    name, known = package_name(enclave), enclave_names(session)
    where, subject = session.workspace.origin(session.enclaves), subject_of(name)
    if name not in known and name in session.packages():
        missing = missing_enclave(session, session.package(name))
        raise KeymintError.of([replace(missing, severity=Severity.ERROR, code="not-installed")])
    if name not in known:
        help_ = did_you_mean(subject, [subject_of(each) for each in known], "'keymint status' lists them")
        raise KeymintError(f"there is no enclave {subject}", where=where, help=help_, code="enclave-unknown")
    values = enclave_environment(session, name)
    run.console.document(exports(values, shell).encode(errors="surrogateescape"))
    result = {"enclave": subject, "variables": dict(values)}
    return run.report(result, other_domain(session, "0"), workspace=session.workspace)
