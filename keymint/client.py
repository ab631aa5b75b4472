# SPDX-License-Identifier: Apache-2.0
"""Provision enclaves from a program, e.g. from a launch file that names its nodes when it runs.

::

    from keymint.client import Client

    client = Client("fleet_ws")
    camera = client.provision("/robot7/camera")
    environment = {"ROS_SECURITY_KEYSTORE": str(camera.keystore), "ROS_SECURITY_ENABLE": "true"}

Every call takes the lock of the workspace, and does what the verb of its name does: nothing is written unless all of it
is right, issued certificates are registered, and a killed call leaves nothing half done. Any number of processes may
work at the same time. There is no daemon.
"""

from __future__ import annotations

import inspect
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from comarmor.values import Data
from keymint import cli
from keymint.api import LoadedPolicy
from keymint.command_line.agreement import another_policy, confirmed_plan
from keymint.command_line.options import Names
from keymint.errors import Diagnostic, KeymintError, Severity, UnconfirmedError, require_none
from keymint.life.terms import DEFAULT, Threshold
from keymint.names import package_name, subject_of
from keymint.output.console import Streams
from keymint.output.report import Report
from keymint.run.run import Run
from keymint.stages.pipeline import CREATE, INSTALL, Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.package_build_types import BUILD
from keymint.workspace.policy_loading import load_policy, locations_digest
from keymint.workspace.session import Inputs, Session

__all__ = ["Client", "Enclave", "KeymintError", "Threshold", "UnconfirmedError"]


class Enclave(Data):
    """An installed enclave.

    Attributes:
        subject: its subject, e.g. ``/robot7/camera``.
        folder: its folder.
        keystore: the install space, for ``ROS_SECURITY_KEYSTORE``.
        changed: the call wrote something into it.
        diagnostics: warnings about it.
    """

    subject: str
    folder: Path
    keystore: Path
    changed: bool
    diagnostics: tuple[Diagnostic, ...] = ()


class Client:
    """A workspace to provision from.

    Args:
        workspace: its folder.

    Raises:
        KeymintError: there is no workspace.
    """

    def __init__(self, workspace: Path | str) -> None:
        self._folder = Path(workspace).absolute()
        self._policy: tuple[str, LoadedPolicy | None] = ("", None)
        run = self._run("client")
        self._workspace = run.workspace()
        self._session = run.inputs(self._workspace).session()

    def provision(self, subject: str, *, prove: bool = True, yes: bool = False) -> Enclave:
        """Create, build, sign, prove and install the enclave of a subject that a profile of the policy applies to.

        What is there and right stays as it is.

        Args:
            subject: its name, which the policy may name by a wildcard only.
            prove: refuse to sign what is not proven to permit exactly what the policy allows.
            yes: take all rights from the subject, or take another policy than the workspace had, if it comes to that.

        Raises:
            UnconfirmedError: that would happen, and ``yes`` is not given.
            KeymintError: the name is illegal, no profile applies to it, its certificate was revoked, or a stage fails.
        """
        name = package_name(subject)

        def make_plan(inputs: Inputs) -> Plan:
            session = inputs.session()
            asked, policy = InstallRequest(prove=prove), self._loaded(session)
            request = Request((name,), (CREATE, BUILD, INSTALL), asked, policy=policy, late=True)
            return confirmed_plan(run, conduct(Work(session), request, run.crew), another_policy(run, session, policy))

        run = self._run("provision", name, yes=yes)
        enclave = self._enclave(run.carry_out(self._workspace, make_plan), name)
        if not enclave.folder.is_dir():
            message = f"the certificate of {subject_of(name)} was revoked, so nothing is issued for its key"
            help_ = f"'keymint renew --rekey {name}' makes a new key"
            raise KeymintError(message, help=help_, code="identity-revoked")
        return enclave

    def renew(self, *subjects: str, threshold: Threshold = DEFAULT, rekey: bool = False) -> tuple[Enclave, ...]:
        """Issue again what is due; see ``keymint renew``.

        Args:
            subjects: the subjects, renewed at any time but on the day of issue; all that are due if there are none.
            threshold: when something is due: after a part of its validity, or a time before its end.
            rekey: make new keys.

        Returns:
            The enclaves that were renewed.

        Raises:
            KeymintError: a subject is not known, or something cannot be issued.
        """
        from keymint.commands.life.renew import renew  # noqa: PLC0415 - of no use to other calls

        return self._enclaves_of(self._verb(renew, subjects, threshold=threshold, rekey=rekey, prove=True))

    def revoke(self, *subjects: str, reason: str) -> tuple[Enclave, ...]:
        """Revoke the certificates of subjects; see ``keymint revoke``.

        Args:
            subjects: the subjects.
            reason: one of :data:`keymint.life.register.REASONS`.

        Returns:
            The enclaves to deploy and restart: those with a new revocation list or a new certificate.

        Raises:
            KeymintError: a subject never had a certificate, or something cannot be issued.
        """
        from keymint.commands.life.revoke import revoke  # noqa: PLC0415 - of no use to other calls

        return self._enclaves_of(self._verb(revoke, subjects, reason=reason, prove=True))

    def bundle(self, subject: str, output: Path | str) -> Path:
        """Write the enclave of a subject into a bundle, for ``keymint accept`` on its robot; see ``keymint bundle``.

        Args:
            subject: the subject.
            output: the file, or an existing folder to put it into; relative to the current directory.

        Returns:
            The file. It is 0600 if it has the private key.

        Raises:
            KeymintError: the enclave is not installed as its sources are now, or the authority's key is not here.
        """
        from keymint.commands.robots.bundle import bundle  # noqa: PLC0415 - of no use to other calls

        (made,) = self._verb(bundle, (subject,), output=Path(output), staged=False).result["bundles"]
        return Path(made["file"])

    # -- how -----------------------------------------------------------------------------------------------------

    def _verb(self, command: Any, subjects: Iterable[str], **options: Any) -> Report:
        """Carry out a verb.

        Raises:
            KeymintError: what it reports as errors.
        """
        run = self._run(command.name, *subjects, *map(repr, sorted(options.items())))
        report: Report = inspect.unwrap(command.callback)(run, names=Names(tuple(subjects), None), **options)
        require_none(each for each in report.diagnostics if each.severity is Severity.ERROR)
        return report

    def _enclaves_of(self, report: Report) -> tuple[Enclave, ...]:
        """Return the enclaves that a run changed."""
        names = dict.fromkeys(step.package for step in report.steps if step.stage == "install" and step.writes())
        names |= dict.fromkeys(self._finished())
        enclaves = (self._enclave(report, name) for name in names if name)
        return tuple(each for each in enclaves if each.folder.is_dir())

    def _run(self, verb: str, *arguments: str, yes: bool = False) -> Run:
        setting = cli.setting(cli.call_of(("client", verb, *arguments)), Streams(io.StringIO(), io.StringIO()))
        options = {"quiet": True, "verbose": 0, "as_json": False, "workspace": self._folder, "jobs": 1, "yes": yes}
        self._latest = Run(setting, verb, options)
        return self._latest

    def _finished(self) -> tuple[str, ...]:
        """Return the packages that the latest run changed in place of one that was interrupted."""
        before = self._latest.interrupted
        return before.packages if before and before.finished else ()

    def _enclave(self, report: Report, name: str) -> Enclave:
        steps = [step for step in report.steps if step.package == name and step.stage == "install"]
        own = tuple(each for each in report.diagnostics if each.subject in {subject_of(name), ""})
        require_none(each for each in own if each.severity is Severity.ERROR)
        changed = any(step.writes() for step in steps) or name in self._finished()
        return Enclave(subject_of(name), self._session.enclave(name), self._workspace.install, changed, own)

    def _loaded(self, session: Session) -> LoadedPolicy:
        """Return the policy, which is loaded again if one of its files changed."""
        known, policy = self._policy
        fingerprint = session.policy_type.fingerprint
        locations = locations_digest(session)
        if (
            policy is None
            or known != locations
            or any(fingerprint(path) != value for path, value in policy.seen.items())
        ):
            policy = load_policy(session)
            self._policy = locations, policy
        return policy
