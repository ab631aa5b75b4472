# SPDX-License-Identifier: Apache-2.0
"""``keymint learn --from-keystore``: the policy that the signed documents of a keystore mean."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from comarmor.errors import Diagnostic, Origin
from comarmor.text import counted
from keymint.api import GrantedRules
from keymint.command_line.named_files import deliver, refuse_replacing
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import PolicyOptions
from keymint.output.report import Report
from keymint.run.run import Run
from keymint.stages.proof.proof_results import ProofEffort


def from_keystore(
    run: Run, keystore: Path, output: Path | None, policy_options: PolicyOptions, *, force: bool
) -> Report:
    """Learn a policy from the signed documents of a keystore, prove it, and write it.

    Args:
        run: the run.
        keystore: folder of the keystore.
        output: the file to write; None for standard output.
        policy_options: the options of the policy to write.
        force: replace a file with different content.

    Raises:
        KeymintError: a signature does not verify, no policy can say what a document grants, or the proof fails; with
            its place.
    """
    from keymint.adoption.keystore_files import found_in  # noqa: PLC0415
    from keymint.adoption.keystore_policy import Learning, learned_from  # noqa: PLC0415 - graphs need none of it

    policies = Policies(run, policy_options)
    policies.shipped()  # an unknown distribution is wrong usage, whatever the keystore is
    _, reader, files, found = found_in(run.plugins, run.setting.cwd / keystore, str(keystore), run.setting.now)
    effort = ProofEffort(run.setting.monotonic)
    name = str(output or "policy.xml")
    learning = Learning(reader, policy_options.policy_type, policies.distro, name, effort)
    learned = learned_from(run.plugins, files, found, learning)
    if output is not None and not force:
        refuse_replacing_policy(run, output, learned.document)
    delivered = deliver(run, output, learned.document)
    if output is not None:
        subjects = counted(len(learned.granted), "subject")
        run.console.line(f"{subjects}: proven to allow, for all names, what the signed documents permit")
    result: dict[str, Any] = {
        "domains": sorted({domain for each in learned.granted for domain in _domains(each)}),
        **delivered,
        "policy": None if output else learned.document.decode(),
        "missing": [],
        "unused": [],
    }
    diagnostics = (*learned.diagnostics, *_about_domains(learned.granted, output))
    return run.report(result, diagnostics)


def refuse_replacing_policy(run: Run, output: Path, document: bytes) -> None:
    """Refuse to replace a file that has other content than a learned policy.

    Raises:
        KeymintError: it exists, and is different.
    """
    help_ = "name another file, compare it with the graph by --policy, or replace it with --force"
    refuse_replacing(run, output, document, "the learned policy", help_, "learn-exists")


def _domains(granted: GrantedRules) -> Iterator[int]:
    for each in granted.domains:
        yield from range(each.first, each.last + 1)


def _about_domains(granted: Sequence[GrantedRules], output: Path | None) -> Iterator[Diagnostic]:
    """Yield a warning unless all documents are for domain 0 alone: a policy contains no domain."""
    groups: dict[tuple[int, ...], list[str]] = {}
    for each in granted:
        if domains := tuple(_domains(each)):
            groups.setdefault(domains, []).append(each.rules.subject)
    if len(groups) > 1:
        shown = "; ".join(f"{_in_words(domains)} ({subjects[0]})" for domains, subjects in groups.items())
        message = f"the documents are for different domains: {shown}; the policy allows all in each"
        help_ = "to keep the domains separate, have one keystore and one workspace for each"
    elif groups.keys() <= {(0,)}:
        return
    else:
        (domains,) = groups
        message = f"the documents are for {_in_words(domains)}; policies contain no domain"
        help_ = f"keymint provision {output or 'POLICY'} --domain {domains[0]}"
    yield Diagnostic.warning("learn-domain", message, Origin(str(output)) if output else None, help_)


def _in_words(domains: Sequence[int]) -> str:
    if len(domains) == 1:
        return f"domain {domains[0]}"
    return f"{len(domains)} domains, {domains[0]} to {domains[-1]}"
