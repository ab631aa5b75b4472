# SPDX-License-Identifier: Apache-2.0
"""``examples/renewal``: the script, the units of systemd and the job of CI, each tried as far as a test can."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
import yaml
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from keymint.pki import certificates
from tests.conftest import CHECKOUT, NOW

FOLDER = CHECKOUT / "examples" / "renewal"
SCRIPT = FOLDER / "renew.sh"
DAY = 86_400
DUE, LATE = 250, 3500


def environment(days: int) -> Mapping[str, str]:
    """The clock, and this environment's ``keymint`` before any other."""
    programs = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    identity = {
        f"GIT_{who}_{what}": "robot@example.com" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")
    }
    return {**os.environ, **identity, "PATH": programs, "SOURCE_DATE_EPOCH": str(NOW + days * DAY)}


def run(days: int, *command: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=cwd, env=environment(days), capture_output=True, text=True, check=False)


@pytest.fixture
def ws(keymint: Callable, tmp_path: Path) -> Path:
    made = keymint("provision", CHECKOUT / "examples/talker_listener/talker_listener.xml", "-w", "ws", "--no-prove")
    assert made.code == 0, made.err
    return tmp_path / "ws"


def end(ws: Path) -> float:
    return certificates.load((ws / "install/enclaves/talker/cert.pem").read_bytes()).not_valid_after_utc.timestamp()


class TestScript:
    def test_it_renews_checks_and_writes_for_the_monitor(self, ws: Path, tmp_path: Path) -> None:
        metrics = tmp_path / "keymint.prom"
        assert run(0, SCRIPT, ws, metrics).returncode == 0
        before = end(ws)
        done = run(DUE, SCRIPT, ws, metrics)
        assert done.returncode == 0, done.stderr
        assert end(ws) > before
        families = {each.name: each for each in text_string_to_metric_families(metrics.read_text())}
        [found] = {sample.value for sample in families["keymint_certificate_expiry_timestamp_seconds"].samples}
        assert found == end(ws)
        assert list(tmp_path.glob("*.new")) == []

    def test_a_due_authority_needs_a_person(self, ws: Path) -> None:
        done = run(LATE, SCRIPT, ws)
        assert done.returncode == 3
        assert "the authority 'identity_ca' is due" in done.stderr

    def test_what_was_not_renewed_is_a_failure(self, ws: Path) -> None:
        path = ws / "src/talker/permissions.xml"
        path.write_text(path.read_text().replace("<ros_publish/>", "<ros_publsh/>"))
        assert run(DUE, SCRIPT, ws).returncode == 1

    def test_what_check_finds_is_told(self, ws: Path) -> None:
        (ws / "install/enclaves/talker/key.pem").chmod(0o644)
        done = run(0, SCRIPT, ws)
        assert done.returncode == 3
        assert "file-mode" in done.stderr or "has mode 0644" in done.stderr

    def test_without_a_workspace(self) -> None:
        done = run(0, SCRIPT)
        assert done.returncode != 0
        assert "usage: renew.sh WORKSPACE [METRICS]" in done.stderr


class TestSystemd:
    @pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze")
    def test_the_units_are_valid(self, tmp_path: Path) -> None:
        for name in ("keymint-renew.service", "keymint-renew.timer"):
            text = (FOLDER / name).read_text().replace("/usr/local/lib/keymint/renew.sh", str(SCRIPT))
            (tmp_path / name).write_text(text)
        units = sorted(tmp_path.glob("keymint-renew.*"))
        done = run(0, "systemd-analyze", "verify", "--recursive-errors=no", *units)
        complaints = [line for line in done.stderr.splitlines() if "keymint-renew" in line]
        assert (done.returncode, complaints) == (0, [])

    def test_an_invalid_unit_would_be_found(self, tmp_path: Path) -> None:
        if shutil.which("systemd-analyze") is None:
            pytest.skip("no systemd-analyze")
        unit = tmp_path / "keymint-renew.service"
        unit.write_text((FOLDER / unit.name).read_text().replace("Type=oneshot", "Type=onshot"))
        done = run(0, "systemd-analyze", "verify", "--recursive-errors=no", unit)
        assert "onshot" in done.stderr

    def test_the_service_may_write_what_it_writes(self, ws: Path, tmp_path: Path) -> None:
        """The command of the unit, with its paths in this test's folder."""
        text = (FOLDER / "keymint-renew.service").read_text()
        [command] = re.findall("^ExecStart=(.*)$", text, re.MULTILINE)
        [writable] = re.findall("^ReadWritePaths=(.*)$", text, re.MULTILINE)
        script, workspace, metrics = command.split()
        assert [workspace, str(Path(metrics).parent)] == writable.split()
        assert Path(script).name == SCRIPT.name
        done = run(DUE, SCRIPT, ws, tmp_path / Path(metrics).name)
        assert done.returncode == 0, done.stderr


class TestJob:
    @pytest.fixture
    def repository(self, ws: Path, tmp_path: Path) -> Path:
        """The workspace under version control, with a server to push to."""
        server = tmp_path / "server.git"
        for command in (
            ("git", "init", "-q", "--bare", "-b", "main", server),
            ("git", "init", "-q", "-b", "main", ws),
            ("git", "-C", ws, "add", "."),
            ("git", "-C", ws, "commit", "-qm", "robots"),
            ("git", "-C", ws, "remote", "add", "origin", server),
            ("git", "-C", ws, "push", "-qu", "origin", "main"),
        ):
            done = run(0, *command)
            assert done.returncode == 0, done.stderr
        return server

    def carried_out(self, ws: Path, days: int) -> list[int]:
        """Carry out the steps of the job as a runner does, and return their exit codes."""
        document = yaml.safe_load((FOLDER / "renew.yml").read_text())
        [job] = document["jobs"].values()
        assert set(job["env"]) == {"WORKSPACE"}
        codes: list[int] = []
        for step in job["steps"]:
            if any(codes) and step.get("if") != "always()":
                continue
            command = step["run"].replace("/usr/local/lib/keymint/renew.sh", str(SCRIPT))
            shell = ("bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", command)
            codes.append(subprocess.run(shell, env={**environment(days), "WORKSPACE": str(ws)}, check=False).returncode)
        return codes

    def log(self, server: Path) -> list[str]:
        return run(0, "git", "-C", server, "log", "--format=%s", "--name-only", "main").stdout.split("\n")

    def test_what_was_renewed_is_pushed(self, ws: Path, repository: Path) -> None:
        assert self.carried_out(ws, 0) == [0, 0, 0]
        assert "Renew certificates" not in self.log(repository)
        assert self.carried_out(ws, DUE) == [0, 0, 0]
        log = self.log(repository)
        assert log[0] == "Renew certificates"
        changed = {line for line in log[1 : log.index("robots")] if line}
        assert changed == {"src/listener/issuance.xml", "src/talker/issuance.xml"}
        assert self.carried_out(ws, DUE + 1) == [0, 0, 0]
        assert self.log(repository) == log

    def test_a_due_authority_fails_the_job_after_the_rest_was_done(self, ws: Path, repository: Path) -> None:
        assert self.carried_out(ws, LATE) == [0, 3, 0]
        assert self.log(repository)[0] == "Renew certificates"


def test_the_rules_of_alerts_name_metrics_that_exist(ws: Path) -> None:
    text = (FOLDER / "README.md").read_text()
    [rules] = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    names = {name for rule in yaml.safe_load(rules) for name in re.findall(r"keymint_\w+", rule["expr"])}
    out = run(0, "keymint", "status", "-w", ws, "--format", "openmetrics").stdout
    assert len(names) == 3
    assert names <= {family.name for family in text_string_to_metric_families(out)}
