# SPDX-License-Identifier: Apache-2.0
"""``keymint report``: evidence for an audit, in one file.

It judges nothing itself: each part is what another verb reports about the same snapshot of the workspace.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from comarmor.patterns.glob import Glob, parse
from comarmor.patterns.relations import disjoint
from comarmor.text import encodable_value, natural_order, quote
from comarmor.values import replace
from keymint import __version__
from keymint.analysis.policy_diff import diff_policies
from keymint.analysis.symbolic_search import STATES, QueryBudget
from keymint.api import LoadedPolicy
from keymint.command_line.named_files import made_of, told_written, write_outputs
from keymint.command_line.named_policies import Policies, workspace_library_rules
from keymint.command_line.options import PolicyOptions, period
from keymint.command_line.verb import FILE, Report, Run, findings_if, option, parameters_of, path_option, verb
from keymint.commands.assure.check import advisories, check, vendors_option
from keymint.commands.assure.prove import prove
from keymint.commands.assure.status import status
from keymint.commands.life.authority_show import authority_show
from keymint.commands.life.issued import issued_certificates
from keymint.commands.understand.query import legal_expression
from keymint.drawing.html_report import audit_page
from keymint.errors import Diagnostic, KeymintError, Severity, usage_error
from keymint.examine.authorities import EXPOSURES
from keymint.examine.keystore import REGISTER_IS_OLDER
from keymint.examine.report_signer import report_signer
from keymint.host.git import at_revision, revision_before
from keymint.output.audit_rights import MOST, reach_json, rights_json
from keymint.output.differences import differences_json
from keymint.output.report import diagnostic_json, merged_diagnostics
from keymint.pki import certificates, cms
from keymint.workspace.policy_loading import load_policy
from keymint.workspace.session import Session

_UNREAD = frozenset({"not-examined", "git-unknown"})
_T = TypeVar("_T")


@verb(dry_run=True, processes=True)
def report(
    run: Run,
    output: Path = path_option("-o", kind=FILE, required=True),
    since: str | None = option(metavar="REV"),
    safety: tuple[str, ...] = option(multiple=True, metavar="PATTERN"),
    soon: timedelta = option(type=period, default="31d", metavar="PERIOD", show_default=True),
    vendors: str | None = vendors_option,
    sign: str | None = option(metavar="AUTHORITY"),
) -> Report:
    """Write evidence for an audit: rights by risk, who reaches what, certificates, changes, proofs, findings, runs.

    All parts are read from one snapshot of the workspace, by the verbs that show them one by one. What cannot be
    read is unknown, and the report says so; it also lists what it does not examine. The page needs no network and
    no script. docs/audit.md explains the page, and shows how to make an authority that signs reports.

    Exit code 3: a part is unknown. Findings are in the report; 'keymint check' fails on them.

    \b
    keymint report -o audit.html --safety '/*/cmd_vel' --since 7d
    keymint report -o audit.json --sign audit_ca

    Options:
        output: Write to this file; its suffix is .html or .json.
        since: List rights gained and lost since a Git revision of the workspace, or of a policy (REV:PATH), or since a
            time: 12h, 7d, 4w.
        safety: Critical objects, e.g. '/*/cmd_vel': rights on them come first. May be repeated.
        soon: Mark what ends within this time.
        vendors: Name known vulnerabilities of access control in these versions of vendors [without a list: those that
            are installed here].
        sign: Also write FILE.p7s: a signature by this authority, which no robot may obey.
    """
    if output.suffix not in (".html", ".json"):
        raise usage_error(f"{output} is neither .html nor .json", "name a file like audit.html or audit.json")
    tuple(advisories(run, vendors))  # an error in the list is one of usage
    patterns = [parse(legal_expression(each)) for each in safety]
    session = run.session(auditing=True)
    with closing(run.tokens):
        signer = report_signer(session, sign) if sign else None
        evidence = _Evidence(run, session, soon)
        document = evidence.document(since, patterns, vendors)
        document["options"] = {"since": since, "safety": safety, "until": session.now + soon, "vendors": vendors}
        document["signer"] = signer and {"authority": sign, "key": certificates.fingerprint(signer.certificate)}
        as_json = json.dumps(encodable_value(document), indent=2, ensure_ascii=True) + "\n"
        content = audit_page(document) if output.suffix == ".html" else as_json.encode()
        beside = {f"{output.name}.p7s": cms.sign(content, signer.certificate, signer.key)} if signer else {}
    written = write_outputs(run, output, content, beside)
    run.console.lines(told_written(run, output, written))
    result = {"file": str(output), "written": written, "report": document}
    told = [*evidence.unread, *_unmatched(document["rights"] or (), dict(zip(safety, patterns, strict=True)))]
    return run.report(result, told, findings_if(evidence.unread), workspace=session.workspace)


class _Part(Run):
    """The run of a verb that is a part of a report: it reads the snapshot of the report, and prints nothing.

    Args:
        run: the run of the report.
        session: the snapshot.
        verb: name of the verb.
    """

    def __init__(self, run: Run, session: Session, verb: str) -> None:
        options = {"quiet": True, "verbose": 0, "as_json": True, "dry_run": run.dry_run, "jobs": run.jobs}
        super().__init__(run.setting, verb, options)
        self.plugins, self.folder_names = run.plugins, run.folder_names
        self.known_workspace, self._session = run.known_workspace, session

    def session(self, *, auditing: bool = False) -> Session:
        """Return the snapshot of the report, which is one for auditing."""
        del auditing
        return self._session


def _unmatched(rights: Sequence[Mapping[str, Any]], safety: Mapping[str, Glob]) -> Iterator[Diagnostic]:
    """Yield a warning for each critical object, by its pattern as written, that no right is about."""
    expressions = {each["expression"] for each in rights} if safety else ()
    for text, pattern in safety.items():
        if expressions and all(disjoint(pattern, parse(each)) for each in expressions):
            help_ = "correct the pattern, unless nobody may use such an object"
            yield Diagnostic.warning("safety-unmatched", f"no right is about {quote(text)}", help=help_)


class _Evidence:
    """Collects the parts of a report.

    Args:
        run: the run.
        session: the snapshot of the workspace.
        soon: what ends within this time ends soon.

    Attributes:
        unread: why parts are unknown.
    """

    def __init__(self, run: Run, session: Session, soon: timedelta) -> None:
        self.unread: list[Diagnostic] = []
        self._run, self._session, self._soon = run, session, soon
        self._unknown: dict[str, str] = {}
        self._findings: list[Diagnostic] = []

    def document(self, since: str | None, safety: Sequence[Glob], vendors: str | None) -> dict[str, Any]:
        """Return the report as JSON data; arguments as the options of the verb."""
        run, session = self._run, self._session
        policy = self._known("policy", lambda: load_policy(session))
        rights, reach, left = None, None, 0
        if policy is not None:
            rights = rights_json(policy, safety, workspace_library_rules(session), run.typed)
            reach, left = reach_json(policy, rights, run.typed)
        made = dict(line.split(" sha256 ") for line in made_of(run, policy, session)[1:])
        # The proof and what ends soon are parts of their own.
        versions = () if vendors is None else (f"--vendors={vendors}",)
        checked = self._of("check", "checked", _called(check, "--no-prove", "--without-private", *versions))
        proofs = self._of("prove", "", _called(prove))
        packages = self._of("status", "packages", _called(status))
        runs = self._of("runs", "runs", _called(status, "--log"))
        issued = self._of("issued", "certificates", self._issued)
        authorities = self._of("authorities", "authorities", _called(authority_show))
        changes = since and policy and self._known("changes", lambda: self._changes(since, policy))
        if policy is None:  # then 'prove' has a result without claims
            proofs = None
            self._unknown |= dict.fromkeys(("prove", *(["changes"] if since else ())), self._unknown["policy"])
        found = merged_diagnostics([*map(run.as_typed, self._findings)])
        findings = [each for each in found if each.code not in {"assumption", *_UNREAD}]
        unread = [each.message for each in found if each.code in _UNREAD]
        revoked = None if issued is None else [each for each in issued if each["revoked"]]
        return {
            "format": "keymint-audit",
            "version": 1,
            "at": session.now,
            "keymint": __version__,
            "workspace": session.profile.name,
            "distribution": session.profile.distro,
            "sha256": {"policy": made.get("policy"), "keystore": made.get("keystore")},
            "unknown": self._unknown,
            "not_examined": [*unread, *_unasked(since, vendors, left)],
            "rights": rights,
            "reach": reach,
            "ends": self._ends(packages, authorities, issued),
            "certificates": issued,
            "authorities": authorities,
            "revoked": revoked,
            "exposed": None if checked is None or revoked is None else _exposed(findings, revoked),
            "changes": changes or None,
            "proofs": proofs,
            "findings": [*map(diagnostic_json, findings)],
            "runs": runs,
        }

    def _known(self, part: str, make: Callable[[], _T]) -> _T | None:
        """Return a part; None if it cannot be made, which the report then says."""
        try:
            return make()
        except KeymintError as error:
            found = [replace(self._run.as_typed(each), severity=Severity.WARNING) for each in error.diagnostics]
            self.unread += [replace(each, message=f"the part {part!r} is unknown: {each.message}") for each in found]
            self._unknown[part] = "; ".join(each.message for each in found)
            return None

    def _of(self, part: str, member: str, make: Callable[[Run], Report]) -> Any:
        """Return a member of the result of a verb, or all of it, and keep what the verb found; None if it failed."""
        made = self._known(part, lambda: make(_Part(self._run, self._session, part)))
        self._findings += made.diagnostics if made else ()
        return made and (made.result[member] if member else made.result)

    def _issued(self, part: Run) -> Report:
        """Return what ``issued`` reports; unknown without the register, and if the check found that it is older."""
        register = self._session.workspace.register
        if self._session.tree.is_left_out(register):
            message, help_ = "you may not read the register of certificates", "run this as the owner of private/"
            where = self._session.workspace.origin(register)
            raise KeymintError(message, where=where, help=help_, code="not-examined")
        if older := next((each for each in self._findings if each.code == REGISTER_IS_OLDER), None):
            raise KeymintError.of([older])
        return _called(issued_certificates)(part)

    def _changes(self, since: str, policy: LoadedPolicy) -> Mapping[str, Any]:
        """Return what ``diff`` reports since a revision or a time, of the workspace or of a policy in a repository."""
        run, profile, root = self._run, self._session.profile, self._session.workspace.root
        environment, revision = run.setting.environment, since
        with suppress(click.BadParameter):
            if len(since) < _SHORTEST_REVISION:
                revision = revision_before(run.setting.now - period(since), root, environment)
        old, folder = (revision, run.setting.cwd) if ":" in revision else (f"{revision}:./", root)
        with at_revision(old, folder, environment) as (name, path, top):
            run.folder_names[f"{top}/"] = f"{name}:"
            options = PolicyOptions(None, profile.profile_type, profile.policy_type)
            before = Policies(run, options).load(path, as_accepted=True)
            found = diff_policies(before, policy, QueryBudget(STATES))
            subjects = differences_json(found, run.typed)
        return {"since": since, "revision": revision, "equivalent": not found, "subjects": subjects}

    def _ends(self, *sources: Sequence[Mapping[str, Any]] | None) -> list[dict[str, Any]] | None:
        """Return when certificates, permissions and lists end, the first end first; None if a source is unknown."""
        if any(each is None for each in sources):
            return None
        packages, authorities, issued = (each or () for each in sources)
        now, last = self._session.now, self._session.now + self._soon
        lists = (each for each in authorities if each["revocation_list"])
        living = (each for each in issued if not each["revoked"] and each["not_after"] >= now)
        found = {
            *((each["certificate_expires"], "certificate", each["subject"]) for each in packages),
            *((each["permissions_expire"], "permissions", each["subject"]) for each in packages),
            *(
                (each["certificate"]["not_after"], "authority", each["name"])
                for each in authorities
                if each["certificate"]
            ),
            *((each["revocation_list"]["next_update"], "revocation list", each["name"]) for each in lists),
            *((each["not_after"], "certificate", each["subject"] or each["serial"]) for each in living),
        }
        known = (each for each in found if each[0] is not None)
        return [
            {"what": what, "whose": whose, "not_after": end, "days": (end - now).days, "soon": end <= last}
            for end, what, whose in sorted(known, key=lambda each: (*each[:2], natural_order(each[2])))
        ]


def _exposed(findings: Sequence[Diagnostic], revoked: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the secrets that others can read, or could read."""
    keys = (
        (each["subject"], f"revoked: {each['reason']}", "") for each in revoked if each["reason"] == "key-compromise"
    )
    named = [(each, each.subject or (each.where and each.where.file)) for each in findings if each.code in EXPOSURES]
    found = [*((whose, each.message, each.help) for each, whose in named), *keys]
    return [{"whose": whose, "why": why, "help": help_} for whose, why, help_ in found]


def _called(command: click.Command, *words: str) -> Callable[[Run], Report]:
    """Return the function of a verb with the options that a command line gives."""
    function = inspect.unwrap(cast("Callable[..., Any]", command.callback))
    parameters, groups = parameters_of(function)
    values = command.make_context(command.name, [*words]).params
    options = {str(each.name): values[str(each.name)] for each in parameters}
    options |= {name: group.taken(options) for name, group in groups.items()}
    return partial(function, **options)


_SHORTEST_REVISION = 4
"""Git takes no shorter abbreviation of a commit, so that ``12h`` is never one."""


def _unasked(since: str | None, vendors: str | None, left: int) -> Iterator[str]:
    """Yield what the report does not examine, since nobody asked, or by its nature."""
    if since is None:
        yield "what changed: no revision was given ('--since')"
    if vendors is None:
        yield "known vulnerabilities of the versions of vendors that robots have ('--vendors')"
    if left:
        yield f"who reaches {left} more objects: {MOST} were asked about ('keymint query who can' asks about one)"
    yield "the copies on robots, and what runs there: only the keystore of this workspace was read"
    yield "the software of vendors: the proofs rest on models of the versions listed here ('keymint verify' asks them)"
    yield "the policy itself: whether it says what its authors mean ('keymint lint', 'keymint test')"
