# SPDX-License-Identifier: Apache-2.0
"""The harness of real Zenoh itself: no process or file outlives its test, and a dead process is an error."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from keymint_ros2_zenoh.vendors import zenoh_processes
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohError, ZenohSystem

from keymint.host import vendor_process
from keymint.host.vendor_process import MissingVendorError, ProcessFailedError

from .conftest import missing
from .zenoh_system import ZenohTestSystem

pytestmark = pytest.mark.zenoh


def test_no_process_or_file_outlives_its_system(zenoh_library: str) -> None:
    started = []

    def failing() -> None:
        with ZenohTestSystem(os.environ) as system:
            started.append(system.file("secret.json5", b"{}"))
            process = system.start()
            process.ask("accept", file=str(started[0]))
            started.append(process._process.pid)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing()
    file, pid = started
    assert not file.parent.exists()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_refused_command_is_an_error_and_the_process_goes_on(zenoh_system: ZenohSystem, tmp_path: Path) -> None:
    process = zenoh_system.start()
    with pytest.raises(ZenohError):
        process.ask("accept", file=str(zenoh_system.file("bad.json5", b"{nonsense: 1}")))
    process.ask("accept", file=str(zenoh_system.file("good.json5", b"{}")))


def test_a_process_that_dies_is_an_error_with_its_exit_code(zenoh_system: ZenohSystem) -> None:
    process = zenoh_system.start()
    process._process.kill()
    with pytest.raises(ProcessFailedError, match="died at 'zid' with exit code -9"):
        process.ask("zid", session="none")


def test_a_process_that_hangs_is_an_error(zenoh_system: ZenohSystem, monkeypatch: pytest.MonkeyPatch) -> None:
    import signal

    process = zenoh_system.start()
    process._process.send_signal(signal.SIGSTOP)
    monkeypatch.setattr(vendor_process, "GRACE_SECONDS", 0.1)
    with pytest.raises(ProcessFailedError, match="did not answer the command 'zid' in time"):
        process.ask("zid", session="none")


def test_files_are_private(zenoh_system: ZenohSystem) -> None:
    file = zenoh_system.file("key.pem", b"secret")
    assert (file.stat().st_mode & 0o777, file.parent.stat().st_mode & 0o777) == (0o600, 0o700)


def test_a_missing_library_skips_the_test_or_fails_it_if_vendors_are_required(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh_processes.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(MissingVendorError) as raised:
        zenoh_processes.installed_version()
    monkeypatch.delenv("KEYMINT_REQUIRE_VENDORS", raising=False)
    with pytest.raises(pytest.skip.Exception, match="Zenoh: no library eclipse-zenoh; pip install eclipse-zenoh"):
        missing(raised.value)
    monkeypatch.setenv("KEYMINT_REQUIRE_VENDORS", "1")
    with pytest.raises(pytest.fail.Exception, match="KEYMINT_REQUIRE_VENDORS=1, but Zenoh: no library"):
        missing(raised.value)


def test_a_library_that_is_too_old_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh_processes.importlib.util, "find_spec", lambda _: object())
    monkeypatch.setattr(zenoh_processes.importlib.metadata, "version", lambda _: "1.5.9")
    with pytest.raises(MissingVendorError, match=r"eclipse-zenoh 1\.5\.9 is older than 1\.6"):
        zenoh_processes.installed_version()


def test_the_benchmark_of_the_router_prints_a_row(zenoh_library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is the only user of these processes beside the transport and the tests."""
    monkeypatch.delenv("SOURCE_DATE_EPOCH")  # its certificates are for now
    program = Path(__file__).parents[2] / "benchmarks/zenoh_router.py"
    command = [sys.executable, str(program), "--sizes", "2", "--messages", "100", "--repeat", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("| 2 | ")
