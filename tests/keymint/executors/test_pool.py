# SPDX-License-Identifier: Apache-2.0
"""Processes that carry out parts of the work."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import Future
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from keymint.api.plugin_loader import Plugins
from keymint.errors import ExitCode, KeymintError
from keymint.executors import cluster as worker
from keymint.executors.cluster import cluster
from keymint.executors.pool import Pool, divide, in_order
from tests.conftest import CHECKOUT


@given(st.lists(st.integers(), max_size=50), st.integers(1, 20))
def test_parts_together_are_all_items_in_order(items: list[int], number: int) -> None:
    parts = divide(items, number)
    assert [item for part in parts for item in part] == items
    assert len(parts) == number
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize(
    ("size", "items", "least", "parts"), [(1, 100, 1, 1), (2, 100, 1, 8), (2, 100, 40, 2), (4, 3, 9, 1)]
)
def test_little_work_stays_in_one_part(size: int, items: int, least: int, parts: int) -> None:
    assert len(Pool(Plugins(()), size).parts(range(items), least)) == parts


def test_no_more_tasks_wait_than_allowed() -> None:
    running: list[int] = []
    most = 0

    def submit(task: int) -> Future[int]:
        nonlocal most
        running.append(task)
        most = max(most, len(running))
        future: Future[int] = Future()
        future.set_result(task)
        return future

    done = []
    for future in in_order(submit, range(20), 5):
        done.append(future.result())
        running.remove(done[-1])
    assert done == list(range(20))
    assert most == 5


def run(code: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process that may fork."""
    begin = "import os\nfrom keymint.executors.pool import Pool\nfrom keymint.api.plugin_loader import Plugins\n"
    begin += "from keymint.errors import KeymintError\npool = Pool(Plugins(()), 2)\n"
    return subprocess.run(
        [sys.executable, "-c", begin + code], cwd=CHECKOUT, capture_output=True, text=True, check=False
    )


def test_results_come_in_the_order_of_the_tasks_from_other_processes() -> None:
    done = run("""
import time
def work(plugins, task):
    time.sleep(0.2 if task == 0 else 0)
    return task, os.getpid()
results = list(pool.map(work, range(6)))
assert [task for task, _ in results] == [0, 1, 2, 3, 4, 5]
assert os.getpid() not in {process for _, process in results}
""")
    assert done.returncode == 0, done.stderr


def test_one_task_is_done_in_this_process() -> None:
    done = run("assert list(pool.map(lambda plugins, task: os.getpid(), [0])) == [os.getpid()]")
    assert done.returncode == 0, done.stderr


def test_a_process_that_is_killed_ends_the_work_with_one_error() -> None:
    done = run("""
def work(plugins, task):
    os.kill(os.getpid(), 9)
try:
    list(pool.map(work, range(6)))
except KeymintError as error:
    print(error.diagnostics[0].code)
""")
    assert done.stdout == "executor-lost\n", done.stderr


def test_an_error_of_the_work_is_raised_as_it_is() -> None:
    done = run("""
from comarmor.errors import ExitCode, Origin
def work(plugins, task):
    where, code = Origin("policy.xml", 7), ExitCode.FINDINGS
    raise KeymintError(f"wrong {task}", where=where, help="mend it", code="a-code", exit_code=code)
try:
    list(pool.map(work, range(6)))
except KeymintError as error:
    print(error, error.exit_code.name, error.diagnostics[0].code)
""")
    assert done.stdout == "policy.xml:7: wrong 0 (mend it) FINDINGS a-code\n", done.stderr


# -- what a worker of a cluster does, without a cluster ---------------------------------------------------------------

NOW = datetime(2027, 1, 15, tzinfo=UTC)


def halves(_plugins: Plugins, task: int) -> tuple[int, Path]:
    """Return half of an even number."""
    if task % 2:
        raise KeymintError(f"{task} is odd", code="odd", exit_code=ExitCode.FINDINGS)
    return task // 2, Path(f"/{task}")


def broken(_plugins: Plugins, task: int) -> int:
    """Have a bug."""
    return 1 // task


def answered(work: Any, task: object, installed: str | None = None) -> Any:
    here = worker.versions(Plugins())
    answer = worker.carry_out(worker.request(work, task, NOW, installed or here))
    return worker.result_of(work, answer, installed or here)


def test_a_worker_answers_with_the_result() -> None:
    assert answered(halves, 8) == (4, Path("/8"))


def test_an_error_of_the_work_on_a_worker_is_raised_here() -> None:
    with pytest.raises(KeymintError) as raised:
        answered(halves, 7)
    assert (raised.value.diagnostics[0].code, raised.value.exit_code) == ("odd", ExitCode.FINDINGS)


def test_a_bug_on_a_worker_is_one_line() -> None:
    with pytest.raises(KeymintError, match="a worker failed: ZeroDivisionError: "):
        answered(broken, 0)


def test_other_versions_are_named() -> None:
    there = worker.versions(Plugins())
    with pytest.raises(KeymintError, match=r"a worker has .*, where this machine has keymint/0\.0"):
        answered(halves, 8, there.replace(there.splitlines()[0], "keymint/0.0"))


@pytest.mark.parametrize(
    "answer",
    [None, 7, "text", b"", b"+", b"+{", b"+[1]", b'+["1","/"]', b"-[]", b'-{"exit_code":99}', b"+" + b"[" * 100_000],
)
def test_an_answer_of_another_form_is_refused(answer: object) -> None:
    with pytest.raises(KeymintError, match="answered something else"):
        worker.result_of(halves, answer, "")


@pytest.mark.parametrize(
    ("address", "code"),
    [
        ("dask://192.0.2.1:8786", "executor-tls"),
        ("dask://[2001:db8::1]:8786", "executor-tls"),
        ("dask://localhost", "executor-address"),
        ("tcp://localhost:8786", "executor-address"),
        ("dask://localhost:port", "executor-address"),
        ("", "executor-address"),
        ("dask://no-such-host.invalid:8786", "executor-lost"),
    ],
)
def test_a_cluster_over_the_network_needs_tls(address: str, code: str) -> None:
    with pytest.raises(KeymintError) as raised, cluster(address, Plugins(()), NOW, {}, trusted=False):
        pass
    assert raised.value.diagnostics[0].code == code
