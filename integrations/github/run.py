# SPDX-License-Identifier: Apache-2.0
"""What the GitHub action in ``action.yml`` does: lint, test, provision, check, and say what a pull request changes.

Reads ``INPUT_*``, which the action sets from its inputs, and the ``GITHUB_*`` of every runner. Runs in the checkout.
"""

from __future__ import annotations

import hashlib
import json
import os
import posixpath
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import workflow
from pull_request import LONGEST_COMMENT, CheckoutError, CommentError, Comments, PullRequest, base_of, git

_SECRETS = ("INPUT_TOKEN", "GITHUB_TOKEN", "GH_TOKEN", "ACTIONS_RUNTIME_TOKEN", "ACTIONS_ID_TOKEN_REQUEST_TOKEN")
_FINDINGS = 3


def _identity(policy: str) -> str:
    """Return what tells the policies of a repository apart, each of which may be another step of one job."""
    return hashlib.sha256(policy.encode(errors="surrogateescape")).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class Inputs:
    """The inputs of the action; ``action.yml`` describes them."""

    policy: str
    workspace: str
    distro: str
    accept_packages: tuple[str, ...]
    sarif: str
    format: bool
    fail_on_findings: bool
    fail_on_gains: bool
    comment: bool

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Inputs:
        """Return the inputs in an environment.

        Raises:
            ValueError: an input is missing, or neither true nor false.
        """

        def flag(name: str, default: str) -> bool:
            value = environment.get(f"INPUT_{name}") or default
            if value not in ("true", "false"):
                raise ValueError(f"the input {name.lower().replace('_', '-')} is {value!r}, expected true or false")
            return value == "true"

        policy = posixpath.normpath(environment.get("INPUT_POLICY") or "comarmor.d")
        if policy.startswith(("/", "../")) or policy == "..":
            raise ValueError(f"the input policy is {policy!r}, expected a path below the repository")
        temporary = environment.get("RUNNER_TEMP") or tempfile.gettempdir()
        return cls(
            policy=policy,
            workspace=environment.get("INPUT_WORKSPACE") or str(Path(temporary, f"keymint-{_identity(policy)}")),
            distro=environment.get("INPUT_DISTRO", ""),
            accept_packages=tuple(environment.get("INPUT_ACCEPT_PACKAGES", "").split()),
            sarif=environment.get("INPUT_SARIF") or str(Path(temporary, f"keymint-{_identity(policy)}.sarif")),
            format=flag("FORMAT", "true"),
            fail_on_findings=flag("FAIL_ON_FINDINGS", "true"),
            fail_on_gains=flag("FAIL_ON_GAINS", "false"),
            comment=flag("COMMENT", "true"),
        )


@dataclass(frozen=True, slots=True)
class Step:
    """A verb that ran.

    Attributes:
        title: what it did, for people.
        code: its exit code.
        diagnostics: as in ``docs/json.md``.
    """

    title: str
    code: int
    diagnostics: Sequence[Mapping[str, Any]]

    def passed(self, *, with_findings: bool) -> bool:
        """Tell whether it did what it should, or found something only."""
        return self.code == 0 or (self.code == _FINDINGS and with_findings)

    def findings(self) -> Iterator[str]:
        """Yield its findings and errors, a line each."""
        for each in self.diagnostics:
            if each["severity"] != "note":
                place = f"{each['file']}:{each['line'] or 1}: " if each["file"] else ""
                yield f"{place}{each['severity']}: {each['message']}" + (f" ({each['help']})" if each["help"] else "")


def keymint(title: str, *arguments: str, of_policy: Sequence[str] = ()) -> Step:
    """Run a verb and return the step.

    Args:
        title: what it does, for people.
        arguments: the verb and its options.
        of_policy: arguments that may not be read as options, though they may look like some.
    """
    done = _run(*arguments, "--json", "--", *of_policy)
    try:
        diagnostics = json.loads(done.stdout)["diagnostics"]
    except ValueError:
        message = done.stderr.strip() or f"keymint ended with the exit code {done.returncode}"
        diagnostics = [{"severity": "error", "message": message, "file": None, "line": None, "help": "", "code": ""}]
    return Step(title, done.returncode, diagnostics)


def say(step: Step) -> None:
    """Show a step in the log, and annotate what it found."""
    print(workflow.shown("\n".join([f"{step.title}: exit code {step.code}", *step.findings()])))
    for each in step.diagnostics:
        if each["severity"] != "note":
            text = f"{each['message']} ({each['help']})" if each["help"] else each["message"]
            print(workflow.annotation(each["severity"], text, each["file"], each["line"]))


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Keymint without the secrets of the runner; -I keeps modules of the checkout from being imported."""
    return subprocess.run(
        [sys.executable, "-I", "-m", "keymint", *arguments],
        env={name: value for name, value in os.environ.items() if name not in _SECRETS},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        errors="backslashreplace",
        check=False,
    )


def steps(inputs: Inputs) -> Iterator[Step]:
    """Run the verbs on the policy as it is in the checkout; what cannot be read ends the run."""
    distro = ("--distro", inputs.distro) if inputs.distro else ()
    policy = (inputs.policy,)
    lint = keymint("lint", "lint", "--sarif", inputs.sarif, *distro, of_policy=policy)
    yield lint
    if not lint.passed(with_findings=True):
        return
    if inputs.format:
        yield keymint("canonical form", "fmt", "--check", of_policy=policy)
    tests = keymint("tests", "test", *distro, of_policy=policy)
    if [each["code"] for each in tests.diagnostics] != ["tests-none"]:
        yield tests
    accepted = [f"--trust-package={each}" for each in inputs.accept_packages]
    provision = keymint("provision", "provision", "-w", inputs.workspace, *distro, *accepted, of_policy=policy)
    yield provision
    if provision.passed(with_findings=False):
        yield keymint("check of the keystore", "check", "-w", inputs.workspace)


def difference(inputs: Inputs, pull_request: PullRequest, checkout: Path) -> tuple[int, str]:
    """Return what a pull request changes in the policy: exit code of ``diff``, and Markdown.

    The exit code is 3 if a subject gains something, and 1 if the policies could not be compared.
    """
    try:
        base = base_of(pull_request, checkout)
        before = f"{git(checkout, 'rev-parse', '--short=12', base)}:./{inputs.policy}"
        is_new = subprocess.run(["git", "cat-file", "-e", before], cwd=checkout, capture_output=True, check=False)
    except CheckoutError as error:
        return 1, f"The policy was not compared: {error}."
    except (OSError, subprocess.SubprocessError) as error:
        reason = (getattr(error, "stderr", None) or str(error).encode()).decode(errors="replace")
        return (
            1,
            f"The policy was not compared: the base of the pull request is not there.\n\n{workflow.fenced(reason)}",
        )
    distro = ("--distro", inputs.distro) if inputs.distro else ()
    with tempfile.TemporaryDirectory() as folder:
        empty = Path(folder, "none.xml")
        empty.write_text("<profiles/>\n", encoding="utf-8")
        older = str(empty) if is_new.returncode else before
        done = _run("diff", "--format", "markdown", *distro, "--", older, inputs.policy)
    if done.returncode not in (0, _FINDINGS):
        return 1, f"The policy was not compared with that of the base.\n\n{workflow.fenced(done.stderr)}"
    text = done.stdout.partition("\n")[2] if is_new.returncode else done.stdout
    return done.returncode, f"### Access control: a new policy\n{text}" if is_new.returncode else text


def report(inputs: Inputs, taken: Sequence[Step]) -> str:
    """Return the table of the steps, and their findings, in Markdown."""
    lines, found = ["### Keymint", "", "| step | |", "|---|---|"], list[str]()
    for step in taken:
        passed = step.passed(with_findings=not inputs.fail_on_findings)
        findings = list(step.findings())
        found += findings
        number = f", {len(findings)} finding{'s' * (len(findings) > 1)}" if findings else ""
        lines.append(f"| {step.title} | {'passed' if passed else '**failed**'}{number} |")
    return "\n".join([*lines, "", *([workflow.fenced("\n".join(found)), ""] if found else [])])


def comment(inputs: Inputs, pull_request: PullRequest, text: str, environment: Mapping[str, str]) -> None:
    """Write the comment on a pull request, or warn that it cannot be written, e.g. for one of a fork."""
    short = workflow.cut(text, LONGEST_COMMENT, "… cut here: the summary of the job has the rest.")
    try:
        comments = Comments(
            environment.get("GITHUB_API_URL") or "https://api.github.com",
            environment.get("GITHUB_REPOSITORY", ""),
            environment.get("INPUT_TOKEN", ""),
            environment.get("INPUT_COMMENT_AUTHOR") or "github-actions[bot]",
        )
        comments.write(pull_request.number, f"<!-- keymint {_identity(inputs.policy)} -->", short)
    except CommentError as error:
        hint = "the job needs 'permissions: pull-requests: write', which pull requests of forks never have"
        print(workflow.annotation("warning", f"the comment was not written: {error}; {hint}"))


def main(environment: Mapping[str, str]) -> int:
    """Run the action, and return its exit code: 1 if it fails."""
    try:
        inputs = Inputs.of(environment)
        pull_request = PullRequest.of_event(environment.get("GITHUB_EVENT_PATH", ""))
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        print(workflow.annotation("error", str(error) or type(error).__name__))
        return 1
    taken: list[Step] = []
    for step in steps(inputs):
        say(step)
        taken.append(step)
    text = report(inputs, taken)
    readable = taken[0].passed(with_findings=True)
    compared: int | None = None
    if pull_request and readable:
        compared, changes = difference(inputs, pull_request, Path.cwd())
        text = f"{changes}\n\n{text}"
    summary = workflow.cut(text, workflow.LONGEST_SUMMARY, "… cut here: run the verbs on your machine to see all.")
    workflow.append(environment.get("GITHUB_STEP_SUMMARY", ""), f"{summary}\n")
    if pull_request and inputs.comment:
        comment(inputs, pull_request, text, environment)
    has_sarif = Path(inputs.sarif).is_file()
    workflow.append(
        environment.get("GITHUB_OUTPUT", ""),
        workflow.outputs(
            {
                "workspace": inputs.workspace,
                "sarif": inputs.sarif if has_sarif else "",
                "gains": {None: "", 0: "false", _FINDINGS: "true"}.get(compared, "unknown"),
            }
        ),
    )
    passed = all(step.passed(with_findings=not inputs.fail_on_findings) for step in taken)
    if inputs.fail_on_gains and compared:
        print(workflow.annotation("error", "the pull request grants more than before, or what it grants is unknown"))
        passed = False
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main(os.environ))
