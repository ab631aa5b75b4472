"""Where every package stands: ``keymint status``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from keymint.api import LoadedPolicy
from keymint.errors import KeymintError
from keymint.pki import certificates
from keymint.plan import build, create, install
from keymint.plan.authorities import trusted_chains
from keymint.plan.enclaves import CERTIFICATE, installed
from keymint.plan.inputs import Inputs, LoadedProfile, Sources
from keymint.plan.model import Action
from keymint.workspace import packages


@dataclass(frozen=True, slots=True)
class Row:
    """One package.

    Attributes:
        package: its name.
        stage: the last stage that it went through: ``source``, ``built`` or ``installed``; ``orphaned`` for an
            enclave without a source package.
        stale: the first verb that would do something for it, or empty.
        certificate_expires: end of validity of the installed certificate, UTC.
        permissions_expire: end of validity of the grant, UTC.
        problem: one line when the package cannot be loaded.
    """

    package: str
    stage: str
    stale: str
    certificate_expires: datetime | None
    permissions_expire: datetime | None
    problem: str = ""


def overview(inputs: Inputs, loaded: LoadedProfile, policy: LoadedPolicy | None, sources: Sources) -> tuple[Row, ...]:
    """Return a row for every source package and every installed enclave, sorted by name.

    Args:
        inputs: the workspace.
        loaded: its profile.
        policy: its policy, or None when it cannot be loaded: then nothing is held against it.
        sources: the packages' files.
    """
    names = packages(inputs.tree, inputs.workspace.src)
    enclaves = set(installed(inputs, loaded))
    chains = trusted_chains(inputs, loaded)
    rows = [_row(inputs, loaded, policy, sources, name, chains, installed=name in enclaves) for name in names]
    rows += [
        Row(name, "orphaned", "install --prune", _certificate_end(inputs, loaded, name), None)
        for name in enclaves - set(names)
    ]
    return tuple(sorted(rows, key=lambda row: row.package))


def _certificate_end(inputs: Inputs, loaded: LoadedProfile, name: str) -> datetime | None:
    content = inputs.tree.read(inputs.workspace.enclaves(loaded.profile.layout) / name / CERTIFICATE)
    try:
        return certificates.load(content).not_valid_after_utc if content else None
    except KeymintError:
        return None


def _row(
    inputs: Inputs,
    loaded: LoadedProfile,
    policy: LoadedPolicy | None,
    sources: Sources,
    name: str,
    chains: Mapping[str, bytes],
    *,
    installed: bool,
) -> Row:
    documents = install.built_documents(inputs, name)
    stage = "installed" if installed else "built" if documents else "source"
    files = sources.files(inputs, name)
    end = _certificate_end(inputs, loaded, name)
    stale, problem, permissions_end = "", "", None
    try:
        package = sources.load(inputs, loaded, name, files)
        permissions_end = package.permissions.validity.not_after
        if policy and _differs_from_policy(inputs, loaded, policy, sources, name):
            stale = "create"
    except KeymintError as error:
        stale, problem = "create", str(error.diagnostics[0])
    if not stale:
        if not documents or not build.is_current(inputs, loaded, name, files):
            stale = "build"
        elif not installed or not install.is_current(inputs, loaded, name, files, chains):
            stale = "install"
    return Row(name, stage, stale, end, permissions_end, problem)


def _differs_from_policy(
    inputs: Inputs, loaded: LoadedProfile, policy: LoadedPolicy, sources: Sources, name: str
) -> bool:
    plan = create.plan_create(inputs, loaded, policy, [name], sources, force=False)
    return any(step.action is not Action.UNCHANGED for step in plan.steps)
