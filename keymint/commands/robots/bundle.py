# SPDX-License-Identifier: Apache-2.0
"""``keymint bundle``: what a robot needs of its installed enclave, in one signed file."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from comarmor.patterns.glob import matches, parse
from comarmor.patterns.tokens import SPECIAL
from comarmor.text import did_you_mean
from keymint.api import Phase
from keymint.authority.authorities import MintedAuthority, plan_authorities
from keymint.authority.rollover import phase_of
from keymint.command_line.named_files import is_folder, show_written, write_outputs
from keymint.command_line.options import complete_package
from keymint.command_line.verb import Report, Run, argument, flag, path_option, verb
from keymint.errors import KeymintError, usage_error
from keymint.examine.keystore import of_enclaves
from keymint.life.workspace_register import withdrawn
from keymint.names import package_name, subject_of
from keymint.output.report import members
from keymint.robots.bundle_making import MadeBundle, plan_bundles
from keymint.stages.install import is_current, would_stay
from keymint.stages.rollover_phases import require_staged, session_ahead
from keymint.store.changes import Plan
from keymint.workspace.installed_enclaves import enclave_names
from keymint.workspace.session import Session

bundle_output_option = path_option(
    "File of the bundle, or folder of several, which are named NAME.bundle [the current directory].",
    "-o",
    metavar="PATH",
)


@verb(dry_run=True)
def bundle(
    run: Run,
    names: tuple[str, ...] = argument(
        nargs=-1, required=True, metavar="NAME|PATTERN...", shell_complete=complete_package
    ),
    output: Path | None = bundle_output_option,
    staged: bool = flag(
        "Of the second keystore, which 'keymint authority replace' staged; accept it into a copy of the keystore."
    ),
) -> Report:
    """Write installed enclaves into bundles, one for each, which robots take with 'keymint accept'.

    A bundle is signed by the authority of the enclave's certificate, and numbered, so that a robot never goes back. It
    has the private key if this workspace made it; then keep it as secret as the key. NAME is an installed package, and
    PATTERN matches the names of several: '/robot1/*'.
    """

    def make_plan(session: Session) -> tuple[Plan, Sequence[MadeBundle]]:
        chosen = _chosen(session, names)
        require_output(run, output, len(chosen))
        ahead, authorities = _second_keystore(run, session) if staged else (None, _in_force(session, chosen))
        return plan_bundles(session, chosen, authorities, ahead)

    report, made = run.made(make_plan)
    return replace(report, steps=(), result={"bundles": write_bundles(run, output, made)})


def _in_force(session: Session, names: Collection[str]) -> Mapping[str, MintedAuthority]:
    """Return the authorities, by which some enclaves are installed as the sources say.

    Raises:
        KeymintError: an enclave is not.
    """
    plan, authorities = plan_authorities(session)
    after = session.after(plan)
    for name in names:
        if reason := withdrawn(session).get(name):
            raise KeymintError(
                f"the certificate of {subject_of(name)} was revoked ({reason}), and its enclave removed",
                help=f"'keymint renew --rekey {name}' makes a new key, or 'keymint sign' certifies one of its robot",
                code="identity-revoked",
            )
        if plan.writes() or not (is_current(after, name) or would_stay(after, name, authorities)):
            raise KeymintError(
                f"the enclave {subject_of(name)} is not installed as its sources and authorities are now",
                where=session.workspace.origin(session.enclave_folder(name)),
                help=f"run 'keymint build {name}' and 'keymint install {name}' first",
                code="not-installed",
            )
    if found := [each for each in of_enclaves(after) if each.subject in set(map(subject_of, names))]:
        raise KeymintError.of(found)
    return authorities


def _second_keystore(run: Run, session: Session) -> tuple[Session, Mapping[str, MintedAuthority]]:
    """Return the session and the authorities of the second keystore.

    Raises:
        KeymintError: there is none, or it is not complete.
    """
    replaced = [each.name for each in session.profile.authorities if phase_of(session, each.name) is Phase.STAGE]
    if not replaced:
        raise KeymintError(
            "there is no second keystore: no authority is replaced that way",
            where=session.profile_marker(),
            help="leave --staged out",
            code="rollover-none",
        )
    require_staged(run.crew, session, replaced[0])
    return session_ahead(session, replaced[0])


def _chosen(session: Session, given: tuple[str, ...]) -> dict[str, None]:
    """Return the packages that the user named, and those with an enclave whose names match a pattern.

    What is not installed has no bundle, e.g. after a revocation; a pattern passes over it.

    Raises:
        KeymintError: there is none.
    """
    known, chosen = session.packages(), dict[str, None]()
    there = frozenset(enclave_names(session))
    for each in given:
        if SPECIAL.search(each):
            which = "no installed package"
            found = [name for name in known if name in there and matches(parse(each), subject_of(name))]
        else:
            which, name = "no package", package_name(each)
            found = [name] if name in known else []
        if not found:
            raise KeymintError(
                f"{which} is called {each!r} in {session.workspace.shown(session.workspace.src)}",
                help=did_you_mean(each, [subject_of(name) for name in known], "'keymint status' lists them"),
                code="package-unknown",
            )
        chosen.update(dict.fromkeys(found))
    return chosen


def require_output(run: Run, output: Path | None, number: int) -> None:
    """Require that several bundles go to a folder.

    Raises:
        KeymintError: they do not; a usage error.
    """
    if number > 1 and output is not None and not is_folder(run, output):
        raise usage_error(f"{output} is no folder, and there are {number} bundles", "make the folder, or name another")


def write_bundles(run: Run, output: Path | None, made: Sequence[MadeBundle]) -> list[dict[str, Any]]:
    """Write bundles, each complete or not at all, and say what they are.

    Returns:
        Each bundle for ``--json``.

    Raises:
        KeymintError: the system refuses.
    """
    documents = []
    for each in made:
        file = f"{each.manifest.name.replace('/', '.')}.bundle"
        target = Path(file) if output is None else output / file if is_folder(run, output) else output
        show_written(run, target, write_outputs(run, target, each.content, secret=each.secret))
        if each.secret:
            run.console.line(
                f"  it has the private key of {each.manifest.enclave}: whoever reads it can act as this enclave"
            )
        documents.append(
            {
                "enclave": each.manifest.enclave,
                "file": str(target),
                "has_private_key": each.secret,
                **members(each.manifest, "key", "authority", "generation", "issue", "revocations", "not_after"),
            }
        )
    run.console.lines(
        f"on a robot that has nothing of this authority yet: keymint accept --authority-fingerprint {authority}"
        for authority in dict.fromkeys(each.manifest.authority for each in made)
    )
    return documents
