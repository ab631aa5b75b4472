# SPDX-License-Identifier: Apache-2.0
"""Processes that carry out parts of the work."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import given, strategies as st

from keymint.host.pool import Pool, divide
from tests.conftest import CHECKOUT


@given(st.lists(st.integers(), max_size=50), st.integers(1, 20))
def test_parts_together_are_all_items_in_order(items: list[int], number: int) -> None:
    parts = divide(items, number)
    assert [item for part in parts for item in part] == items
    assert len(parts) == number
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize(
    ("size", "items", "least", "parts"), [(1, 100, 1, 1), (2, 100, 1, 32), (2, 100, 40, 2), (4, 3, 9, 1)]
)
def test_little_work_stays_in_one_part(size: int, items: int, least: int, parts: int) -> None:
    assert len(Pool(size).parts(range(items), least)) == parts


def run(code: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process that may fork."""
    begin = "import os\nfrom keymint.host.pool import Pool\n"
    begin += "from keymint.errors import KeymintError\npool = Pool(2)\n"
    begin += "here, (seen, tell) = os.getpid(), os.pipe()\n"  # with which the other process tells that it is there
    return subprocess.run(
        [sys.executable, "-c", begin + code], cwd=CHECKOUT, capture_output=True, text=True, check=False
    )


def test_results_come_in_the_order_of_the_tasks_from_this_process_and_others() -> None:
    done = run("""
def work(task):
    if os.getpid() != here:
        os.write(tell, b"!")
    elif task == 5:  # the first one here
        os.read(seen, 1)
    return task, os.getpid()
results = list(pool.map(work, range(6)))
assert [task for task, _ in results] == [0, 1, 2, 3, 4, 5]
processes = [process for _, process in results]
assert processes[-1] == here
assert len(set(processes)) == 2
""")
    assert done.returncode == 0, done.stderr


def test_whoever_is_ready_takes_the_next_task() -> None:
    done = run("""
def work(task):
    if os.getpid() != here:
        os.read(seen, 1)  # until all others are done
    elif task == 599:
        return here
    elif len(done) == 597:
        os.write(tell, b"!")
    done.append(task)
    return os.getpid()
done = []
assert list(pool.map(work, range(600))).count(here) >= 599
""")
    assert done.returncode == 0, done.stderr


def test_one_task_is_done_in_this_process() -> None:
    done = run("assert list(pool.map(lambda task: os.getpid(), [0])) == [os.getpid()]")
    assert done.returncode == 0, done.stderr


def test_a_process_that_is_killed_ends_the_work_with_one_error() -> None:
    done = run("""
def work(task):
    if os.getpid() != here:
        os.write(tell, b"!")
        os.kill(os.getpid(), 9)
    if task == 5:  # the first one here
        os.read(seen, 1)
try:
    list(pool.map(work, range(6)))
except KeymintError as error:
    print(error.diagnostics[0].code)
""")
    assert done.stdout == "executor-lost\n", done.stderr


def test_a_system_that_keeps_no_status_of_ended_processes() -> None:
    done = run("""
import signal
signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # as a supervisor may leave it
def work(task):
    if os.getpid() == here and task == 5:  # the first one here
        os.read(seen, 1)
    else:
        os.write(tell, b"!")
    return task
assert list(pool.map(work, range(6))) == [0, 1, 2, 3, 4, 5]
""")
    assert (done.returncode, done.stderr) == (0, "")


def test_an_error_of_the_work_is_raised_as_it_is() -> None:
    done = run("""
from comarmor.errors import ExitCode, Origin
def work(task):
    where, code = Origin("policy.xml", 7), ExitCode.FINDINGS
    if task < 2:
        return task
    raise KeymintError(f"wrong {task}", where=where, help="mend it", code="a-code", exit_code=code)
try:
    for result in pool.map(work, range(6)):
        print(result)
except KeymintError as error:
    print(error, error.exit_code.name, error.diagnostics[0].code)
""")
    assert done.stdout == "0\n1\npolicy.xml:7: wrong 2 (mend it) FINDINGS a-code\n", done.stderr


def test_a_system_with_no_room_for_another_process() -> None:
    done = run("""
def refuse():
    raise BlockingIOError(11, "Resource temporarily unavailable")
os.fork = refuse
opened = len(os.listdir("/proc/self/fd"))
assert list(pool.map(lambda task: task + os.getpid() - here, range(6))) == [0, 1, 2, 3, 4, 5]
assert len(os.listdir("/proc/self/fd")) == opened
""")
    assert (done.returncode, done.stderr) == (0, "")
