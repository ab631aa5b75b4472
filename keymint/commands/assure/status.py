# SPDX-License-Identifier: Apache-2.0
"""``keymint status``: stage and expiry of every package."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from typing import Any

import click

from comarmor.text import natural_order
from comarmor.values import replace
from keymint.api import LoadedPolicy
from keymint.authority.authority_files import elsewhere
from keymint.command_line.options import Names, names_group, strict_option
from keymint.command_line.verb import Report, Run, findings_if, flag, option, verb
from keymint.errors import Diagnostic, KeymintError
from keymint.examine.authorities import exposed_keys
from keymint.examine.keystore import not_examined
from keymint.examine.rights import has_earlier, presented_rights
from keymint.life.terms import days_left
from keymint.output.console import Console
from keymint.output.openmetrics import gauges, openmetrics
from keymint.output.report import members
from keymint.run.run_log import logged_runs
from keymint.stages.create import packages_to_create
from keymint.stages.package_status import StatusRow, package_rows, shared_rows
from keymint.stages.proof_results import ProofEffort
from keymint.view.tree import Tree
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session

_DEFAULTS = {"OPTION": "option", "VERB": "verb", "DEFAULT": "value", "FROM": "source", "PLACE": "place"}


@verb()
def status(
    run: Run,
    kind: str = option("--format", type=click.Choice(("table", "openmetrics")), default="table", show_default=True),
    strict: bool = strict_option,
    log: bool = flag(),
    names: Names = names_group(),
) -> Report:
    """Show a table of all packages: the stage, whether it is stale, when it expires, and when to renew it.

    RENEW AFTER is the date from which 'keymint renew' renews the package. 'with CA': renew that authority first;
    the package expires with it. NAME is a package [all].

    Options:
        kind: openmetrics: dates in seconds since 1970, for a monitor such as Prometheus.
        log: Show what each run that wrote here did: when, who, which version; the latest last.
    """
    if log:
        return _log(run)
    session = run.session(auditing=True)
    diagnostics: list[Diagnostic] = []
    missing: list[str] | None = None if names else []
    try:
        policy = lazy_policy(session)
    except KeymintError as error:
        policy, diagnostics = None, list(error.diagnostics)
    rows = [_as_typed(run, row) for row in package_rows(session, policy)]
    if names:
        chosen = frozenset(names.packages(run, session, [row.package for row in rows]))
        rows = [row for row in rows if row.package in chosen]
    elif policy:
        missing = _missing(session, policy, rows, diagnostics)
    defaults = _defaults(run) if run.verbosity > 0 and kind == "table" else ()
    shared = [] if names else [_as_typed(run, row) for row in shared_rows(session)]

    def show(console: Console) -> None:
        if kind == "openmetrics":
            console.lines(openmetrics(gauges(session, rows)))
        else:
            _show(console, session.now, rows, missing, shared)
        if defaults:
            console.line()
            console.table(_DEFAULTS, defaults)

    show(run.console)
    result = {
        "packages": [_document(row) for row in rows],
        "not_created": missing or [],
        "shared": [members(row, "build_type", "documents", "stage", "stale", "problem") for row in shared],
    }
    unexamined = tuple(not_examined(session))
    outliving = _outliving(run, session, policy) if policy else ()
    diagnostics += (*elsewhere(session), *exposed_keys(session), *outliving, *unexamined)
    result["not_examined"] = len(unexamined)
    exit_code = findings_if(strict and outliving)
    report = run.report(result, diagnostics, exit_code, workspace=session.workspace, notes=True)
    if defaults:
        result["defaults"] = defaults
    if not diagnostics:
        run.remember(session, _changes([*rows, *shared], session.now), report, show)
    return report


def _missing(
    session: Session, policy: LoadedPolicy, rows: Sequence[StatusRow], diagnostics: list[Diagnostic]
) -> list[str]:
    """Return the packages that the policy names but that do not exist; errors are added to the diagnostics."""
    wanted = {*packages_to_create(session, policy)}
    try:
        wanted |= session.needed_infrastructure().keys()
    except KeymintError as error:
        diagnostics += error.diagnostics
    return sorted(wanted - {row.package for row in rows})


def _defaults(run: Run) -> list[dict[str, Any]]:
    """Return what options are if they are not given, and where that comes from."""
    from keymint.command_line.defaults import default_rows  # noqa: PLC0415 - only with -v

    return [{**each, "place": each["place"] and run.typed(each["place"])} for each in default_rows(run.defaults)]


def _log(run: Run) -> Report:
    """Show the runs that are on record."""
    workspace = run.workspace()
    runs = logged_runs(Tree(), workspace)
    rows = [
        {
            **each,
            "at": f"{each['at']:%Y-%m-%d %H:%M}Z",
            "who": f"{each['user']}@{each['host']}",
            "did": ", ".join((each["command"], *(f"{number} {action}" for action, number in each["steps"].items()))),
        }
        for each in runs
    ]
    if runs:
        run.console.table({"WHEN": "at", "WHO": "who", "VERSION": "version", "WHAT": "did"}, rows)
    else:
        run.console.line("no run that wrote is on record")
    return run.report({"runs": runs}, workspace=workspace)


def _changes(rows: Sequence[StatusRow], now: datetime) -> Iterator[datetime]:
    """Yield when the rows say something else: they count the days until each date."""
    for row in rows:
        for date in filter(None, (row.certificate_expires, row.permissions_expire, row.renew_after)):
            yield now + (date - now) % timedelta(days=1)


def _outliving(run: Run, session: Session, policy: LoadedPolicy) -> tuple[Diagnostic, ...]:
    """Return the notes on documents that were signed before and permit more than the policy."""
    try:
        if not has_earlier(session):  # then none can permit more than the one in force
            return ()
        return presented_rights(session, session.state, policy, ProofEffort(run.setting.monotonic)).outliving
    except KeymintError:  # a package has defects, which its row shows
        return ()


def _show(
    console: Console,
    now: datetime,
    rows: Sequence[StatusRow],
    missing: Sequence[str] | None,
    shared: Sequence[StatusRow],
) -> None:
    """Show a table, and the problems."""
    columns = ("PACKAGE", "STAGE", "STALE", "CERTIFICATE", "PERMISSIONS", "RENEW AFTER")
    cells = []
    own = (*rows, *(StatusRow(name, "-", "create") for name in missing or ()))
    for row in (*sorted(own, key=lambda each: natural_order(each.package)), *shared):
        title = row.package or ", ".join(row.documents) or row.build_type or "shared documents"
        ends = (_when(row.certificate_expires, now), _when(row.permissions_expire, now), _renewal(row, now))
        cells.append(dict(zip(columns, (title, row.stage, row.stale, *ends), strict=True)))
    console.table(dict(zip(columns, columns, strict=True)), cells)
    problems = [(row.package or row.build_type or "shared documents", row.problem) for row in (*rows, *shared)]
    console.messages([f"{whose}: {problem}" for whose, problem in problems if problem])
    if not cells and missing is not None:
        console.line("no packages; run 'keymint create --all'")


def _as_typed(run: Run, row: StatusRow) -> StatusRow:
    """Return a row with the paths of its problem as the user would type them."""
    if not row.problem:
        return row
    return replace(row, problem=run.as_typed(Diagnostic.error("problem", row.problem)).message)


def _when(end: datetime | None, now: datetime) -> str:
    """Return a date with the number of days until it."""
    return f"{end:%Y-%m-%d} ({days_left(end, now)})" if end else "-"


def _renewal(row: StatusRow, now: datetime) -> str:
    """Return from when on a package is renewed, or the authority that must be renewed before."""
    moment = row.renew_after
    if moment is None:
        return f"with {row.ends_with}" if row.ends_with else "-"
    return f"{moment:%Y-%m-%d} ({'due' if moment <= now else f'{(moment - now).days} d'})"


def _document(row: StatusRow) -> dict[str, Any]:
    ends = members(row, "certificate_expires", "permissions_expire", "renew_after", "ends_with", "problem")
    return {"package": row.package, "subject": f"/{row.package}", **members(row, "stage", "stale"), **ends}
