# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: compare the installed keystore with its expected state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta
from functools import partial
from pathlib import Path

from comarmor.text import did_you_mean, quantity
from comarmor.values import replace
from keymint.command_line.named_files import write_outputs
from keymint.command_line.options import Names, names_group, period, standard_option, strict_option
from keymint.command_line.verb import FILE, Report, Run, findings_if, flag, option, path_option, verb
from keymint.errors import Diagnostic, KeymintError, Severity, usage_error
from keymint.examine.check import check as find
from keymint.examine.keystore import SHOWN_NOTES, not_examined, proven_keystore
from keymint.examine.nodes import NODE_NOTES, of_packages
from keymint.host.pool import Pool
from keymint.life.examine import RIGHTS_OUTLIVE
from keymint.life.workspace_register import with_enclaves
from keymint.names import subject_of
from keymint.output.report import merged_diagnostics
from keymint.output.sarif import of_diagnostics, sarif as sarif_log
from keymint.stages.create import other_domain, policy_changed, subjects_without_package
from keymint.stages.proof_results import ProofEffort, proof_findings
from keymint.stages.prove import NO_PROVER, STAGE
from keymint.view.stamps import State
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session

INSTALLED = "installed"
"""Value of ``--vendors`` without a list."""
vendors_option = option(is_flag=False, flag_value=INSTALLED, metavar="NAME=VERSION,...")


@verb(processes=True)
def check(
    run: Run,
    names: Names = names_group(),
    within: timedelta = option(type=period, default="0d", metavar="PERIOD"),
    no_prove: bool = flag(),
    fresh: bool = flag(),
    allow_vendor_specific: bool = standard_option,
    strict: bool = strict_option,
    sarif: Path | None = path_option(kind=FILE),
    vendors: str | None = vendors_option,
    without_private: bool = flag(),
) -> Report:
    """Compare the installed keystore with its expected state, and prove it.

    Checks certificates, keys, signatures, schemas, dates, file modes, revocation lists, and whether the installed
    documents match the sources; proves that they permit exactly what the policy says, as 'keymint prove' does.
    Notes subjects whose nodes cannot start with default options.
    docs/verification.md says in one table what each verb reads.
    Exit code 3: there are findings, or you may not read all of private/. NAME is a package [all].

    Options:
        within: Also report certificates and grants that expire within this time: 12h, 30d, 4w.
        no_prove: Leave out the proof that installed documents permit what the policy says.
        fresh: Prove again what was proven before.
        sarif: Write the findings as SARIF 2.1.0.
        vendors: Name known vulnerabilities of access control in these versions of vendors [without a list: those that
            are installed here].
        without_private: Exit with 0 although you may not read all private keys and the register.
    """
    session = run.session(auditing=True)
    chosen = names.packages(run, session)
    effort = None if no_prove else ProofEffort(run.setting.monotonic, standard_only=allow_vendor_specific)
    prove = partial(_proven, session, chosen, effort, run.pool, fresh=fresh, strict=strict)
    of_keystore, (state, of_proof) = find(session, chosen, within, run.pool, prove)
    known = {(each.code, each.where and each.where.file) for each in of_keystore}
    new = (each for each in of_proof if (each.code, each.where and each.where.file) not in known)
    findings = [*of_keystore, *new]
    if any(each.code == "counterexample" for each in findings):
        findings += policy_changed(session)  # the cause, if it is that
    unexamined = tuple(not_examined(session))
    findings += advisories(run, vendors)
    of_policy, state = _of_policy(session, state, chosen, complete=not names)
    findings += (each for each in of_policy if each not in findings)
    shown = merged_diagnostics((*findings, *unexamined))
    if sarif is not None:
        write_outputs(run, sarif, sarif_log("keymint check", of_diagnostics(shown), run.typed))
    number = sum(finding.severity is not Severity.NOTE for finding in shown)
    if not number:
        run.keep(session, state)
    more = f"; {len(unexamined)} not examined" if unexamined else ""
    more += "; not proven, because of --no-prove" if no_prove else ""
    run.console.line(f"checked {quantity(len(chosen), 'enclave')}: {quantity(number, 'finding')}{more}")
    result = {
        "checked": [subject_of(name) for name in chosen],
        "proven": not no_prove,
        "not_examined": len(unexamined),
    }
    outlive = strict and any(each.code == RIGHTS_OUTLIVE for each in shown)
    exit_code = findings_if(number or outlive or (unexamined and not without_private))
    shown = (*shown, *other_domain(session))  # no finding on the keystore
    return run.report(result, shown, exit_code, workspace=session.workspace, notes=SHOWN_NOTES | NODE_NOTES)


def _proven(
    session: Session, packages: Sequence[str], effort: ProofEffort | None, pool: Pool, *, fresh: bool, strict: bool
) -> tuple[State, tuple[Diagnostic, ...]]:
    """Return the record to keep, and the findings of the proof; without an effort or a policy there are none."""
    if effort is None or not session.profile.policies:
        return session.state, ()
    names = with_enclaves(session, packages, named=False)
    if fresh:
        proven = tuple(session.state.stamps.get(STAGE, ()))
        session = replace(session, state=session.state.updated(STAGE, {}, proven))
    try:
        results = proven_keystore(session, names, lazy_policy(session), effort, lambda _: None, pool)
    except KeymintError as error:
        return session.state, error.diagnostics
    found = proof_findings(session, results, strict=strict)
    return results.state, tuple(each for each in found if each.code != NO_PROVER)


def _of_policy(
    session: Session, state: State, names: Sequence[str], *, complete: bool
) -> tuple[Sequence[Diagnostic], State]:
    """Return notes on packages whose nodes cannot start, and, if these are all, findings on subjects without one.

    If they are all, what keeps the policy from being read is a finding as well. The record to keep comes second.
    """
    try:
        policy = lazy_policy(session)
        notes, state = of_packages(session, state, policy, names)
        return (*(subjects_without_package(session, policy, names) if complete else ()), *notes), state
    except KeymintError as error:
        return error.diagnostics if complete else (), state


def advisories(run: Run, given: str | None) -> Iterator[Diagnostic]:
    """Yield the findings on versions of vendors; none without the option.

    Raises:
        KeymintError: the list is malformed, or names an unknown vendor; a usage error.
    """
    if given is None:
        return
    plugins = [run.plugins.build_type(name) for name in run.plugins.names("keymint.build_types")]
    by_vendor = {name: each for each in plugins for name in each.VENDORS}
    if given != INSTALLED:
        for name, version in _listed(given, by_vendor):
            yield from by_vendor[name].advisories(name, version)
        return
    for plugin in dict.fromkeys(by_vendor.values()):
        for name, versions in plugin.installed_vendors(run.setting.environment).items():
            for version in versions:
                yield from plugin.advisories(name, version)


def _listed(given: str, known: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    for part in given.split(","):
        name, is_pair, version = (each.strip() for each in part.partition("="))
        if not is_pair:
            raise usage_error(f"--vendors {given}: {part!r} is not NAME=VERSION", f"known names are {', '.join(known)}")
        if name not in known:
            names = did_you_mean(name, known, f"known are {', '.join(known)}")
            raise usage_error(f"--vendors {given}: unknown vendor {name!r}", names)
        yield name, version
