# SPDX-License-Identifier: Apache-2.0
"""``keymint accept``: a robot takes what an authority made for its enclaves."""

from __future__ import annotations

import re
from pathlib import Path

from comarmor.text import lazy_regex
from comarmor.values import Data
from keymint.command_line.named_files import read_input
from keymint.command_line.robot_options import folder_option, keystore_of, opened_store
from keymint.command_line.verb import FILE, Report, Run, argument, flag, option, verb
from keymint.errors import KeymintError, Origin, usage_error
from keymint.examine.bundles import Acceptance, Owner, accept as accepted
from keymint.output.report import members
from keymint.robots import bundle as bundles
from keymint.robots.bundle import MAX_BYTES, Bundle
from keymint.robots.robot_keystore import Keystore
from keymint.store.changes import Action, Step

_FINGERPRINT = lazy_regex("[0-9a-f]{64}")


class _Taken(Data):
    """A bundle that is accepted, and what it changes."""

    file: Path
    bundle: Bundle
    acceptance: Acceptance
    step: Step


@verb(workspace=False, dry_run=True)
def accept(
    run: Run,
    files: tuple[Path, ...] = argument(nargs=-1, required=True, type=FILE, metavar="BUNDLE..."),
    folder: Path | None = folder_option,
    fingerprints: tuple[str, ...] = option("--authority-fingerprint", multiple=True, metavar="SHA256"),
    new: bool = flag(),
) -> Report:
    """Accept bundles that an authority made for this robot, each for one enclave: 'keymint sign', 'keymint bundle'.

    Needs no workspace. A bundle is accepted if an authority that this keystore trusts signed it, if this robot has
    its key, and if none of its numbers is lower than the last one; otherwise nothing changes. The folder of an
    enclave changes in one step.

    Options:
        fingerprints: Trust the authority with this key; needed the first time, and when an authority gets a new key.
            'keymint authority show' prints it, where the authority is. May be repeated.
        new: Take a bundle for an enclave that this robot neither has nor asked for.
    """
    keystore = keystore_of(run, folder)
    owner = Owner(frozenset(map(fingerprint, fingerprints)), new=new)
    read = [(file, bundles.read(read_input(run, file, MAX_BYTES), Origin(str(file)))) for file in dict.fromkeys(files)]
    first: dict[str, Path] = {}
    for file, each in read:
        other = first.setdefault(each.manifest.enclave, file)
        if other != file:
            message = f"is for {each.manifest.enclave}, as {other} is"
            help_ = "take the one with the higher issue number"
            raise KeymintError(message, where=Origin(str(file)), help=help_, code="bundle-twice")
    taken = [_taken(run, keystore, file, each, owner) for file, each in read]  # what is refused creates no keystore
    if not run.dry_run:
        with opened_store(run, keystore) as store:
            there = keystore_of(run, folder)
            taken = [_taken(run, there, file, each, owner) for file, each in read]
            answered = [there.forget(each.bundle.manifest.name) for each in taken if each.acceptance.answered]
            store.begin(run.intent())
            store.commit(store.stage(change for each in taken for change in each.step.changes))
            # A key must be in its enclave, durably, before it is removed here.
            store.commit(store.stage(answered))
    restart = [each.bundle.manifest.enclave for each in taken if each.step.writes()]
    told = [f"restart the processes of {each}: they read their files when they start" for each in restart]
    run.console.messages([] if run.dry_run else told)
    notes = [note for each in taken for note in each.acceptance.notes]
    result = {
        "keystore": keystore.shown,
        "enclaves": [_document(each) for each in taken],
        "restart": restart,
    }
    return run.report(result, notes, steps=[each.step for each in taken])


def fingerprint(text: str) -> str:
    """Return a fingerprint that a person typed: 64 hexadecimal digits; colons, spaces and their case do not matter.

    Raises:
        KeymintError: it is none; a usage error.
    """
    plain = re.sub("[: ]", "", text).lower()
    if not _FINGERPRINT.fullmatch(plain):
        raise usage_error(f"{text!r} is not a fingerprint of 64 hexadecimal digits", "copy all of it")
    return plain


def _taken(run: Run, there: Keystore, file: Path, bundle: Bundle, owner: Owner) -> _Taken:
    """Decide about a bundle; errors as :func:`keymint.examine.bundles.accept`."""
    manifest = bundle.manifest
    present = there.present(manifest.folder, manifest.name)
    found = accepted(bundle, present, owner, run.setting.now, Origin(str(file)))
    change = there.take(manifest.folder, manifest.name, found.files, found.removed)
    changes = (change,) if change.written or change.removed else ()
    action = (Action.UPDATED if present.files else Action.CREATED) if changes else Action.UNCHANGED
    detail = f"issue {manifest.issue}, until {manifest.not_after:%Y-%m-%d}"
    return _Taken(file, bundle, found, Step(run.verb, manifest.name, action, changes, detail))


def _document(taken: _Taken) -> dict[str, object]:
    manifest = taken.bundle.manifest
    return {
        "enclave": manifest.enclave,
        "bundle": str(taken.file),
        "action": taken.step.action,
        **members(manifest, "key", "authority", "generation", "issue", "revocations", "not_before", "not_after"),
        "answers_request": taken.acceptance.answered,
    }
