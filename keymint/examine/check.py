# SPDX-License-Identifier: Apache-2.0
"""Compare the installed keystore with its expected state: ``keymint check``.

The build type checks the content of an enclave. This package checks the workspace: modes, the record of installed
files, unexpected files, authorities, and the files that all enclaves share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import timedelta
from functools import partial
from typing import Any

from comarmor.errors import Diagnostic
from comarmor.regex import lazy_regex
from keymint.api import Inspection
from keymint.api.plugin_loader import Plugins
from keymint.errors import KeymintError
from keymint.examine.authorities import (
    authorities,
    elsewhere,
    encryption,
    exposed_keys,
    git_exposure,
    in_defect,
)
from keymint.examine.enclaves import LoadedEnclave, examine, load
from keymint.examine.files import file_status, outside_enclaves
from keymint.examine.keystore import deciding_findings, staged_keystore_session
from keymint.executors import Pool
from keymint.stages import identity_keys
from keymint.stages.identity_keys import Keyring
from keymint.workspace.installed_enclaves import orphan_findings, with_sources
from keymint.workspace.session import Session

LEAST = 64
"""Enclaves that are worth a process of their own."""


def check(session: Session, names: Sequence[str], within: timedelta, pool: Pool) -> tuple[Diagnostic, ...]:
    """Return all findings on the enclaves of some packages, and on their workspace.

    Args:
        session: the workspace and its profile.
        names: names of packages.
        within: report what expires within this time.
        pool: where to examine many enclaves: processes of this machine, since they read private keys.
    """
    of_authorities = tuple(authorities(session, within))
    keyring = Keyring(session)
    loaded = [load(session, name, within) for name in names]
    first = [examine(session, each, keyring) for each in loaded[:1]]  # processes have then what all enclaves need
    parts = pool.parts(loaded[1:], LEAST)
    tasks: list[Callable[[], Iterable[Any]]] = [
        partial(outside_enclaves, session, within), partial(file_status, session), partial(git_exposure, session),
        partial(_deciding, session),
    ]  # fmt: skip
    tasks += (partial(map, partial(examine, session, keyring=keyring), part) for part in parts)
    alone = len(parts) <= 1
    found = (tuple(task()) for task in tasks) if alone else pool.map(_carry_out, tasks)
    around, of_files, of_git, decides, *examined = found
    enclaves: list[tuple[str, str, Sequence[Diagnostic]]] = [each for part in (first, *examined) for each in part]
    findings = [finding for _, _, of_enclave in enclaves for finding in of_enclave]
    findings += _of_several(session, loaded)
    findings += orphan_findings(session)
    findings += (each for each in decides if each not in findings)  # the defects of packages are found above
    fingerprints = {name: fingerprint for name, fingerprint, _ in enclaves if fingerprint}
    findings += identity_keys.shared_keys(session, fingerprints)
    findings += (*elsewhere(session), *encryption(session), *exposed_keys(session))
    findings += around
    later = _without_install_hints(findings, in_defect(of_authorities))
    return (*of_authorities, *of_files, *of_git, *later, *_of_second_keystore(session, names, within, pool))


def _deciding(session: Session) -> tuple[Diagnostic, ...]:
    try:
        return tuple(deciding_findings(session))
    except KeymintError as error:  # a package has defects, or the register
        return error.diagnostics


def _of_second_keystore(
    session: Session, names: Sequence[str], within: timedelta, pool: Pool
) -> tuple[Diagnostic, ...]:
    """Return the findings on a keystore that lies beside the one in force, judged as if it were that one."""
    try:
        ahead = staged_keystore_session(session)
    except KeymintError as error:
        return error.diagnostics
    if ahead is None:
        return ()
    ready = frozenset(with_sources(ahead))
    found = check(ahead, [name for name in names if name in ready], within, pool)
    return tuple(each for each in found if each.code not in _OF_RECORD)


_OF_RECORD = frozenset({"record-missing", "key-missing"})
"""Codes of findings on what nobody records, or has, of a second keystore."""


def _carry_out(_plugins: Plugins, task: Callable[[], Iterable[Any]]) -> tuple[Any, ...]:
    return tuple(task())


def _of_several(session: Session, loaded: Iterable[LoadedEnclave]) -> Iterator[Diagnostic]:
    """Yield the findings that concern several enclaves."""
    by_type: dict[str, list[Inspection]] = {}
    for each in loaded:
        if not each.is_absent:
            for build_type, (_, own) in each.seen.items():
                by_type.setdefault(build_type, []).append(own)
    for build_type, of_type in sorted(by_type.items()):
        yield from session.plugins.build_type(build_type).check_all(of_type)


def _without_install_hints(findings: Iterable[Diagnostic], defect: Diagnostic | None) -> Iterator[Diagnostic]:
    """Yield findings without the hint to install, if a defect of an authority must be fixed first."""
    for finding in findings:
        installs = defect is not None and _INSTALLS.search(finding.help)
        yield replace(finding, help=f"fix {defect.where} first") if installs and defect else finding


_INSTALLS = lazy_regex(r"'keymint (install|provision)")
