# SPDX-License-Identifier: Apache-2.0
"""The GitHub action: its steps run in a checkout, with stand-ins for the runner and for the API."""

from __future__ import annotations

import hashlib
import importlib
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from tests.conftest import CHECKOUT
from tests.integrations.github import ACTION, BOT, TOKEN, Api, Job, git, run_action, served
from tests.ros_packages import HREF, PACKAGE, fragment, including, ship, topic

POLICY = (CHECKOUT / "examples/talker_listener/talker_listener.xml").read_text()
WIDER = POLICY.replace("<attachment>/chatter</attachment>", "<attachment>/chatter*</attachment>")
EVIL = "a`touch pwned`$(touch pwned) ::error::x;'\"|@team``##[error]&"
"""A name of a folder."""


@pytest.fixture
def api() -> Iterator[Api]:
    with served(Api()) as api:
        yield api


class Project:
    """A repository with a base and a pull request, of which a runner has the merge only.

    Args:
        folder: where it is made.
        path: the policy in it.
    """

    def __init__(self, folder: Path, path: str = "comarmor.d/p.xml") -> None:
        self.folder = folder
        self.path = path
        self.origin = folder / "origin"
        self.origin.mkdir(parents=True)
        git(self.origin, "init", "-q", "-b", "main")
        git(self.origin, "config", "uploadpack.allowAnySHA1InWant", "true")
        self.jobs = 0

    def commit(self, **files: str) -> str:
        for name, content in files.items():
            file = self.origin / (self.path if name == "policy" else name.replace("__", "."))
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(content)
        git(self.origin, "add", "-A")
        git(self.origin, "commit", "-q", "--allow-empty", "-m", "x")
        return git(self.origin, "rev-parse", "HEAD")

    def propose(self, **files: str) -> dict:
        """Commit to a branch, and merge it as GitHub does; return the event, whose base is an older one."""
        base = git(self.origin, "rev-parse", "main")
        git(self.origin, "switch", "-q", "-C", "change", "main")
        head = self.commit(**files)
        git(self.origin, "switch", "-q", "main")
        self.commit(elsewhere="another change")
        git(self.origin, "switch", "-q", "-C", "merged", "main")
        git(self.origin, "merge", "-q", "--no-ff", "-m", "merge", "change")
        return {"pull_request": {"number": 7, "base": {"sha": base}, "head": {"sha": head}}}

    def checkout(self, branch: str) -> Path:
        """Return a new checkout of one commit, as actions/checkout makes it."""
        self.jobs += 1
        checkout = self.folder / f"checkout{self.jobs}"
        source = f"file://{self.origin}"
        git(self.folder, "clone", "-q", "--depth=1", "--branch", branch, source, str(checkout))
        return checkout

    def run(self, event: dict, api: Api | None = None, **inputs: str) -> Job:
        checkout = self.checkout("merged")
        given = {name.replace("_", "-"): value for name, value in inputs.items()}
        job = run_action(checkout, self.folder / f"temp{self.jobs}", api, event=event, inputs=given)
        assert TOKEN not in job.log
        assert not list(self.folder.rglob("pwned"))
        return job


def test_a_pull_request_gets_one_comment_that_is_updated(tmp_path: Path, api: Api) -> None:
    project = Project(tmp_path)
    project.commit(policy=POLICY)
    event = project.propose(policy=WIDER)
    for number in range(100):
        api.add("somebody", f"comment {number}")
    job = project.run(event, api)
    assert job.code == 0, job.log
    assert api.tokens == {f"Bearer {TOKEN}"}
    mine = api.comments[-1]
    assert mine["user"]["login"] == BOT
    marker, _, body = mine["body"].partition("\n")
    assert re.fullmatch(r"<!-- keymint [0-9a-f]{16} -->", marker)
    assert "2 subjects gain" in body
    assert "| gains | `ros_publish` | `/chatter*`" in body.replace("on part of ", "")
    assert "| provision | passed |" in body
    assert "| check of the keystore | passed |" in body
    assert body.rstrip() == job.summary.rstrip()
    assert job.outputs["gains"] == "true"
    assert Path(job.outputs["workspace"], "install/enclaves/talker/permissions.p7s").is_file()
    assert json.loads(Path(job.outputs["sarif"]).read_text())["version"] == "2.1.0"
    # A second run finds something, and updates the comment.
    event = project.propose(policy=POLICY.replace("  <profile", "\t<profile"))
    job = project.run(event, api, fail_on_gains="true")
    assert job.code == 1
    assert "::warning file=comarmor.d/p.xml,line=4::the file is not in canonical form" in job.log
    assert "| canonical form | **failed**, 1 finding |" in job.summary
    assert job.outputs["gains"] == "false"
    assert len(api.comments) == 101
    assert "**Equivalent**" in mine["body"]


def test_what_somebody_names_files_is_no_command(tmp_path: Path, api: Api) -> None:
    project = Project(tmp_path, f"{EVIL}/p.xml")
    evil = WIDER.replace("  <profile", "\t<profile")
    shadows = dict.fromkeys(("keymint__py", "json__py", "lxml__py", "sitecustomize__py"), "open('pwned', 'w')")
    project.commit(policy=POLICY, **shadows)
    job = project.run(project.propose(policy=evil), api, policy=EVIL, fail_on_findings="false", fail_on_gains="true")
    assert job.code == 1
    *commands, last = job.commands()
    assert commands
    assert last == "::error::the pull request grants more than before, or what it grants is unknown"
    assert all(
        re.match(r"::(warning|error) (?=file=a`)[^:,]*%3A%3Aerror%3A%3Ax[^:]*,line=\d+::", each) for each in commands
    )
    assert "| canonical form | passed, 1 finding |" in job.summary
    comment = api.comments[-1]["body"]
    rows = [line for line in comment.splitlines() if "@team" in line and line.startswith("|")]
    assert rows
    spans = r"(?<!`)(`+)(?!`).*?(?<!`)\1(?!`)"  # code spans of CommonMark
    assert all("@team" not in re.sub(spans, "", row) for row in rows)


def test_a_policy_that_cannot_be_read(tmp_path: Path, api: Api) -> None:
    project = Project(tmp_path)
    project.commit(policy=POLICY)
    job = project.run(project.propose(policy="<profiles>\n"), api, fail_on_findings="false")
    assert job.code == 1
    assert "::error file=comarmor.d/p.xml,line=2::not well-formed XML" in job.log
    assert "| lint | **failed**, 1 finding |" in api.comments[-1]["body"]
    assert "provision" not in job.summary
    (result,) = json.loads(Path(job.outputs["sarif"]).read_text())["runs"][0]["results"]
    assert result["locations"][0]["physicalLocation"]["region"]["startLine"] == 2


@pytest.fixture
def action(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script of the action, as a module."""
    monkeypatch.syspath_prepend(str(CHECKOUT / "integrations/github"))
    for name in ("run", "workflow", "pull_request"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module("run")


def changes(action: ModuleType, project: Project, event: dict, patch: pytest.MonkeyPatch) -> tuple[int, str]:
    """Return what the action says about a pull request, without its other steps."""
    checkout = project.checkout("merged")
    patch.chdir(checkout)
    (project.folder / "event.json").write_text(json.dumps(event))
    found = action.PullRequest.of_event(str(project.folder / "event.json"))
    return action.difference(action.Inputs.of({}), found, checkout)


def test_a_policy_that_is_new(action: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project = Project(tmp_path)
    project.commit(README="nothing yet")
    event = project.propose(policy=POLICY)
    code, text = changes(action, project, event, monkeypatch)
    assert code == 3
    assert text.startswith("### Access control: a new policy\n\n2 subjects gain, none lose.\n")


def test_a_base_that_is_not_there_or_cannot_be_read(
    action: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = Project(tmp_path)
    project.commit(policy="<profiles>")
    event = project.propose(policy=POLICY)
    code, text = changes(action, project, event, monkeypatch)
    assert code == 1
    assert text.startswith("The policy was not compared with that of the base.\n\n```text\n")
    assert "not well-formed XML" in text
    other = {"pull_request": {"number": 7, "base": {"sha": "0" * 40}, "head": {"sha": "1" * 40}}}
    code, text = changes(action, project, other, monkeypatch)
    assert code == 1
    assert text.startswith("The policy was not compared: the checkout is ")
    head = git(Path.cwd(), "rev-parse", "HEAD")
    missing = {"pull_request": {"number": 7, "base": {"sha": "0" * 40}, "head": {"sha": head}}}
    code, text = changes(action, project, missing, monkeypatch)
    assert code == 1
    assert text.startswith("The policy was not compared: the base of the pull request is not there.")


def test_the_base_itself_is_not_compared_with_itself(
    action: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for the event pull_request_target, for which actions/checkout takes the base."""
    project = Project(tmp_path)
    project.commit(policy=POLICY)
    event = project.propose(policy=POLICY.replace("ros_subscribe", "ros_publish"))
    event["pull_request"]["head"]["sha"] = "1" * 40
    assert changes(action, project, event, monkeypatch)[0] == 1


def test_two_policies_in_one_job_have_a_workspace_and_a_comment_each(action: ModuleType) -> None:
    first, second = (action.Inputs.of({"INPUT_POLICY": policy, "RUNNER_TEMP": "/t"}) for policy in ("a", "b"))
    assert first.workspace != second.workspace
    assert first.sarif != second.sarif
    assert action.Inputs.of({"INPUT_POLICY": "./a/", "RUNNER_TEMP": "/t"}) == first
    assert action.Inputs.of({"INPUT_WORKSPACE": "ws"}).workspace == "ws"


def test_a_fork_may_not_comment(
    action: ModuleType, tmp_path: Path, api: Api, capsys: pytest.CaptureFixture[str]
) -> None:
    api.status = 403
    environment = {"GITHUB_API_URL": api.address, "GITHUB_REPOSITORY": "o/r", "INPUT_TOKEN": TOKEN}
    action.comment(action.Inputs.of({}), action.PullRequest(7, "0" * 40, "1" * 40), "text", environment)
    shown = capsys.readouterr().out
    assert shown.startswith("::warning::the comment was not written: the token may not comment (HTTP 403)")
    assert TOKEN not in shown


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"policy": "/etc"}, "::error::the input policy is '/etc', expected a path below the repository"),
        ({"policy": "a/../../b"}, "::error::the input policy is '../b', expected"),
        ({"comment": "yes"}, "::error::the input comment is 'yes', expected true or false"),
    ],
)
def test_inputs_that_make_no_sense(tmp_path: Path, inputs: dict[str, str], message: str) -> None:
    job = run_action(tmp_path, tmp_path / "temp", None, event={}, inputs=inputs)
    assert (job.code, job.summary) == (1, "")
    assert job.log.startswith(message)


# -- action.yml --------------------------------------------------------------------------------------------------------


def test_scripts_of_the_action_contain_no_expression_and_name_what_exists() -> None:
    scripts = [step["run"] for step in ACTION["runs"]["steps"] if "run" in step]
    assert len(scripts) == 2
    for script in scripts:
        assert "${{" not in script
        assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0
        for path in re.findall(r'\$GITHUB_ACTION_PATH/([^"]+)"', script):
            assert (CHECKOUT / path).is_file()
    assert all(step.get("shell") == "bash" for step in ACTION["runs"]["steps"] if "run" in step)


def test_the_action_uses_all_of_its_inputs_and_steps() -> None:
    text = (CHECKOUT / "action.yml").read_text()
    used = re.findall(r"\binputs\.([\w-]+)", text)
    assert set(used) == set(ACTION["inputs"])
    steps = {step.get("id") for step in ACTION["runs"]["steps"]}
    assert set(re.findall(r"\bsteps\.([\w-]+)", text)) <= steps
    program = (CHECKOUT / "integrations/github/run.py").read_text()
    (run,) = (step for step in ACTION["runs"]["steps"] if step.get("id") == "run")
    for name in run["env"]:
        assert f'"{name}"' in program or f'"{name.removeprefix("INPUT_")}"' in program
    for output in ACTION["outputs"]:
        assert f'"{output}": ' in program


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_the_script_that_installs_uses_the_action_itself(tmp_path: Path) -> None:
    """With a stand-in for Python: what it is asked for."""
    (step,) = (each for each in ACTION["runs"]["steps"] if each.get("id") == "install")
    python = tmp_path / "python"
    python.write_text(
        '#!/bin/sh\necho "$*" >>"$RUNNER_TEMP/asked"\n'
        '[ "$3" = venv ] || exit 0\nmkdir -p "$5/bin"; cp "$0" "$5/bin/python"\n'
    )
    python.chmod(0o755)
    environment = {
        "PATH": "/usr/bin:/bin",
        "PYTHON": str(python),
        "RUNNER_TEMP": str(tmp_path),
        "GITHUB_ACTION_PATH": "/a b",
    }
    subprocess.run(["bash", "-eo", "pipefail", "-c", step["run"]], env=environment, cwd=tmp_path, check=True)
    asked = (tmp_path / "asked").read_text().splitlines()
    assert asked[0] == f"-I -m venv --clear {tmp_path}/keymint-venv"
    assert asked[1].endswith(" install /a b")


def test_the_page_about_ci_describes_the_action() -> None:
    page = (CHECKOUT / "docs/ci.md").read_text()
    (shown,) = (block for block in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL) if "jobs:" in block)
    steps = yaml.safe_load(shown)["jobs"]["policy"]["steps"]
    assert set(steps[-1]["with"]) <= set(ACTION["inputs"])
    rows = re.findall(r"^\| (`[\w-]+`(?:, `[\w-]+`)*) \|", page, re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"[\w-]+", row)} == set(ACTION["inputs"])


def test_what_ros_packages_ship_is_accepted_by_its_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = ship(tmp_path / "prefix", {"controller.xml": fragment(topic("/cmd_vel"))}) / "controller.xml"
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    project = Project(tmp_path / "project")
    project.commit(policy=including(HREF))
    git(project.origin, "branch", "merged")
    value = hashlib.sha256(f"{hashlib.sha256(shipped.read_bytes()).hexdigest()}  {shipped.name}\n".encode()).hexdigest()
    job = project.run({}, format="false", accept_packages=f"\n {PACKAGE}={value}\n")
    assert job.code == 0, job.log  # nothing is provisioned without it
