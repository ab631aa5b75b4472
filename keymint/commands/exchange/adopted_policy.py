# SPDX-License-Identifier: Apache-2.0
"""The policy of a keystore that is taken over: that which the user names, or one that is learned from it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from keymint.adoption.keystore_policy import AdoptedPolicy, Learning, learned_from
from keymint.api import FoundKeystore, ImportRequest, KeystoreFiles, KeystoreReader
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import PolicyOptions
from keymint.run.run import Run
from keymint.stages.proof.proof_results import ProofEffort
from keymint.stages.workspace_start import policy_path
from keymint.workspace.policy_loading import foreign_policy
from keymint.workspace.workspace import Workspace

STATES = 50_000
"""States that one search may visit."""
FOLDER = "comarmor.d"
"""Folder of a new profile that has the policy."""


def named_policy(
    run: Run,
    path: Path,
    workspace: Workspace,
    options: PolicyOptions,
    subjects: Iterable[str],
    accept: bool,
    implicit: bool,
) -> AdoptedPolicy:
    """Return the policy that the user names: that of another tool is translated into the new profile.

    Args:
        run: the run.
        path: file or folder.
        workspace: the new workspace.
        options: how to read it.
        subjects: the subjects of the keystore.
        accept: take a policy of another tool as it reads where that tool enforces something else.
        implicit: a policy of another tool has the rules that this tool adds by itself.

    Raises:
        KeymintError: the policy is missing, has defects, or cannot be expressed.
    """
    policies, place = Policies(run, options), run.setting.cwd / path
    library = policies.shipped()  # an unknown distribution is wrong usage, whatever the file is
    foreign = foreign_policy(run.plugins, [place], options.policy_type) if place.is_file() else None
    if foreign and foreign.imported:
        name = f"{FOLDER}/{path.name.removesuffix('.xml').removesuffix('.policy')}.xml"
        file, shown = str(workspace.profile / name), workspace.profile / FOLDER
        request = ImportRequest(place, file, library, accept, implicit, shown)
        imported = run.plugins.policy_type(foreign.policy_type).translated(request)
        rules = {each.rules.subject: each.rules for each in imported.subjects}
        return AdoptedPolicy(FOLDER, {name: imported.document}, rules, tuple(rules), diagnostics=imported.diagnostics)
    loaded = policies.at(place, str(path), library_shown=workspace.profile / FOLDER)
    found = {subject: loaded.rules(subject) for subject in subjects}
    rules = {subject: each for subject, each in found.items() if each is not None}
    return AdoptedPolicy(policy_path(place, workspace.profile), {}, rules, tuple(loaded.subjects()))


def learned_policy(
    run: Run,
    reader: KeystoreReader,
    files: KeystoreFiles,
    found: FoundKeystore,
    workspace: Workspace,
    options: PolicyOptions,
) -> AdoptedPolicy:
    """Return a policy that is proven to mean what is signed.

    Args:
        run: the run.
        reader: reads the keystore.
        files: the files of the keystore.
        found: what it has.
        workspace: the new workspace.
        options: how to write the policy.

    Raises:
        KeymintError: no policy can say what a document grants, or the proof fails.
    """
    name = f"{FOLDER}/adopted.xml"
    effort = ProofEffort(run.setting.monotonic, STATES)
    file = str(workspace.profile / name)
    learning = Learning(reader, options.policy_type, Policies(run, options).distro, file, effort)
    learned = learned_from(run.plugins, files, found, learning)
    rules = {each.subject: each for each in learned.subjects}
    return AdoptedPolicy(
        FOLDER, {name: learned.document}, rules, tuple(rules), learned=True, diagnostics=learned.diagnostics
    )
