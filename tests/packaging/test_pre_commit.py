# SPDX-License-Identifier: Apache-2.0
"""The hooks, run by the real pre-commit in a new repository, which installs Keymint from a clone as it does for users.

Where pre-commit is missing these skip; with ``KEYMINT_REQUIRE_VENDORS=1`` in the environment (as in CI) they fail.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

import pytest

from keymint.cli import VERBS
from tests.packaging.conftest import CHECKOUT

pytestmark = pytest.mark.xdist_group("pre-commit")  # one worker, so that the hooks are installed once
HOOKS = CHECKOUT / ".pre-commit-hooks.yaml"
INSTALLED = ("keymint", "comarmor", "plugins", "schemas", "templates", "pyproject.toml", "README.md", "LICENSE")
POLICY = (CHECKOUT / "examples/talker_listener/talker_listener.xml").read_text()
TESTS = """\
<?xml version="1.0" encoding="UTF-8"?>
<tests>
  <test name="t">
    <allow subject="/talker" permission="publish" object="/chatter"/>
  </test>
</tests>
"""


@dataclass(frozen=True)
class Repository:
    """A repository of a user.

    Attributes:
        folder: its folder.
        environment: environment variables of the user.
    """

    folder: Path
    environment: dict[str, str]

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False
        )

    def commit(self, **files: str) -> tuple[int, str]:
        """Write files of the policy, commit all, and return exit code and output."""
        for name, content in files.items():
            path = self.folder / "comarmor.d" / f"{name.replace('_', '.')}.xml"
            (self.folder / "comarmor.d").mkdir(exist_ok=True)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)
        assert self.run("git", "add", "-A").returncode == 0
        done = self.run("git", "commit", "-m", "policy")
        return done.returncode, done.stdout + done.stderr


@pytest.fixture(scope="module")
def hooks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository with the hooks: this checkout as it is now, committed."""
    missing = [name for name in ("git",) if shutil.which(name) is None]
    missing += [] if importlib.util.find_spec("pre_commit") else ["pre-commit"]
    if missing and os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
        pytest.fail(f"KEYMINT_REQUIRE_VENDORS=1, but there is no {' and no '.join(missing)}", pytrace=False)
    if missing:
        pytest.skip(f"there is no {' and no '.join(missing)}: 'make setup' installs pre-commit")
    folder = tmp_path_factory.mktemp("hooks")
    for name in (*INSTALLED, HOOKS.name):
        if (CHECKOUT / name).is_dir():
            shutil.copytree(CHECKOUT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(CHECKOUT / name, folder / name)
    as_somebody = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    for command in (("init", "-q"), ("add", "-A"), (*as_somebody, "commit", "-qm", "hooks"), ("tag", "v1")):
        subprocess.run(["git", *command], cwd=folder, check=True, capture_output=True)
    return folder


def yaml_blocks() -> list[str]:
    """Return what docs/ci.md shows as YAML."""
    return re.findall(r"```yaml\n(.*?)```", (CHECKOUT / "docs/ci.md").read_text(), re.DOTALL)


@pytest.fixture(scope="module")
def repository(hooks: Path, tmp_path_factory: pytest.TempPathFactory) -> Repository:
    """A new repository with the hooks. What they need comes from this environment, not from the network."""
    home = tmp_path_factory.mktemp("home")
    plain = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "PIP_", "GIT_", "PRE_COMMIT"))
    }
    environment = plain | {
        "HOME": str(home),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": sysconfig.get_path("purelib"),
        "PIP_NO_INDEX": "1",
        "PIP_NO_DEPS": "1",
        "PIP_NO_COMPILE": "1",
        "PIP_NO_BUILD_ISOLATION": "0",  # false, which pip reads as: there is no isolation
        "GIT_AUTHOR_NAME": "a",
        "GIT_AUTHOR_EMAIL": "a@example.org",
        "GIT_COMMITTER_NAME": "a",
        "GIT_COMMITTER_EMAIL": "a@example.org",
    }
    repository = Repository(tmp_path_factory.mktemp("repository"), environment)
    shown = next(block for block in yaml_blocks() if block.startswith("repos:"))
    used = re.sub(r"repo: \S+", f"repo: {hooks}", shown).replace("REVISION", "v1")
    (repository.folder / ".pre-commit-config.yaml").write_text(used)
    (repository.folder / "package.xml").write_text("<package  />\n")
    assert repository.run("git", "init", "-q").returncode == 0
    done = repository.run(sys.executable, "-m", "pre_commit", "install", "--install-hooks")
    assert done.returncode == 0, done.stdout + done.stderr
    return repository


def test_the_life_of_a_policy_under_version_control(repository: Repository) -> None:
    code, shown = repository.commit()
    assert code == 0, shown
    assert shown.count("Skipped") == 3  # there is no policy yet
    untidy = POLICY.replace("    <attachment>", "\t<attachment>")
    code, shown = repository.commit(p=untidy, p_test=TESTS)
    assert code == 1
    assert "files were modified by this hook" in shown
    assert "comarmor.d/p.xml written" in shown
    assert (repository.folder / "comarmor.d/p.xml").read_text() == POLICY
    code, shown = repository.commit()
    assert code == 0, shown
    assert shown.count("Passed") == 3
    assert (repository.folder / "package.xml").read_text() == "<package  />\n"


def test_a_finding_stops_a_commit(repository: Repository) -> None:
    shadowed = POLICY.replace(
        "  </profile>\n\n</profiles>",
        '    <ros_topic qualifier="DENY">\n      <attachment>/chatter</attachment>\n'
        "      <permissions><ros_subscribe/></permissions>\n    </ros_topic>\n  </profile>\n\n</profiles>",
    )
    code, shown = repository.commit(p=shadowed, p_test=TESTS)
    assert code == 1
    assert "exit code: 3" in shown
    assert re.search(r"comarmor\.d/p\.xml:\d+: warning: .*DENY", shown), shown


def test_an_expectation_that_fails_stops_a_commit(repository: Repository) -> None:
    code, shown = repository.commit(p=POLICY, p_test=TESTS.replace("publish", "subscribe"))
    assert code == 1
    assert "0 of 1 expectations hold" in shown


def test_a_file_that_cannot_be_read_stops_a_commit_and_stays(repository: Repository) -> None:
    code, shown = repository.commit(p="<profiles>\n", p_test=TESTS)
    assert code == 1
    assert "comarmor.d/p.xml:2: error: not well-formed XML" in shown
    assert (repository.folder / "comarmor.d/p.xml").read_text() == "<profiles>\n"


def test_a_policy_elsewhere(repository: Repository) -> None:
    shown = next(block for block in yaml_blocks() if "files: ^policy/" in block)
    config = repository.folder / ".pre-commit-config.yaml"
    before = config.read_text()
    config.write_text(before[: before.index("      - id: keymint-fmt")] + shown)
    try:
        code, out = repository.commit(**{"../policy/p": POLICY})
        assert (code, out.count("Passed")) == (0, 1), out
    finally:
        config.write_text(before)


def test_hooks_run_verbs_that_exist() -> None:
    entries = [line.split()[1:] for line in HOOKS.read_text().splitlines() if line.strip().startswith("entry:")]
    assert len(entries) == 3
    assert all(words[0] == "keymint" and words[1] in VERBS for words in entries)
