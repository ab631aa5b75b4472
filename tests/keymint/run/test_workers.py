# SPDX-License-Identifier: Apache-2.0
"""Several processes plan what one would plan, and write nothing unless all of it is right.

Commands with several processes run in one of their own, since a process with threads starts no others.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from keymint.run.execution import MIN_PACKAGES, PackedChanges
from keymint.store.changes import File, FolderChange
from tests.conftest import Outcome, snapshot

Keymint = Callable[..., Outcome]
SIZE = MIN_PACKAGES + 10
FEW = 20
"""Packages of tests in which processes start for fewer packages than usual, and each has fewer at a time."""
PROFILE = """<profile name="p{n}">
<attachment>/{folder}robot{n}/talker</attachment>
<ros_topic qualifier="ALLOW">
<attachment>{{namespace}}chatter{n}{wild}</attachment><permissions><ros_publish/></permissions>
</ros_topic>
<ros_topic qualifier="DENY"><attachment>/secret</attachment><permissions><ros_publish/></permissions></ros_topic>
</profile>
"""
MAIN = """
import sys
from keymint.run import execution
from keymint.cli import main
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
sys.exit(main(sys.argv[1:]))
"""
SPY = """
import os, sys
from keymint.host import pool
from keymint.run import execution
from keymint.cli import main
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
whole = pool.send
def copied(pipe, content):
    with open(f"{os.environ['SPY']}/{os.getpid()}", "ab") as file:
        file.write(content)
    whole(pipe, content)
pool.send = copied
sys.exit(main(sys.argv[1:]))
"""
ENDED = """
import os, signal, sys
from keymint.run import execution
from keymint.cli import main
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
from keymint.stages.work import NewPackages
planned = NewPackages.planned
def ended(self, stage, name):
    if (stage.NAME, name) == ({stage!r}, {name!r}):
        os.kill(os.getpid(), signal.SIGKILL)
    return planned(self, stage, name)
NewPackages.planned = ended
sys.exit(main(sys.argv[1:]))
"""

NO_ROOM = """
import os, sys
fork = os.fork
def first_only():
    global fork
    now, fork = fork, None
    if now is None:
        raise BlockingIOError(11, "Resource temporarily unavailable")
    return now()
os.fork = first_only
from keymint.run import execution
from keymint.cli import main
execution.MIN_PACKAGES = 10
sys.exit(main(sys.argv[1:]))
"""


def policy(path: Path, size: int = FEW, *, folder: str = "", extra: str = "") -> Path:
    """Write a policy; every seventh subject has a wildcard."""
    profiles = (PROFILE.format(n=n, folder=folder, wild="" if n % 7 else "*") for n in range(size))
    path.write_text(f"<profiles>\n{''.join(profiles)}{extra}</profiles>\n")
    return path


def run(cwd: Path, *arguments: object, program: str = MAIN, **environment: str) -> Outcome:
    """Run keymint in a process of its own."""
    start = ("-c", program) if program else ("-m", "keymint")
    command = [sys.executable, *start, *map(str, arguments)]
    env = {**os.environ, **environment}
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    return Outcome(done.returncode, done.stdout, done.stderr)


def unsigned(workspace: Path) -> dict[str, bytes]:
    """Return what does not depend on keys: sources and unsigned documents."""
    files = [path for path in workspace.rglob("*") if path.is_file()]
    kept = [path for path in files if path.suffix == ".xml" and path.name != "keymint_profile.xml"]  # has its name
    return {str(path.relative_to(workspace)): path.read_bytes() for path in kept}


def modes(workspace: Path) -> dict[str, int]:
    """Return the mode of each file and folder, except the recorded answer, which a quick run does not have."""
    found = (path for path in workspace.rglob("*") if not path.name.startswith("last-"))
    return {str(path.relative_to(workspace)): path.lstat().st_mode for path in found}


@pytest.mark.parametrize(("folder", "size", "program"), [("", SIZE, ""), ("fleet/", FEW, MAIN)])
def test_any_number_of_processes_gives_the_same(
    keymint: Keymint, tmp_path: Path, folder: str, size: int, program: str
) -> None:
    source = policy(tmp_path / "policy.xml", size, folder=folder)
    reports = {}
    for jobs in (1, 2, 3):
        command = ("provision", source, "-w", f"ws{jobs}", "-j", jobs, "--json")
        done = keymint(*command) if jobs == 1 else run(tmp_path, *command, program=program)
        assert done.code == 0, done.err
        reports[jobs] = json.loads(done.out.replace(f"ws{jobs}", "ws"))
        assert keymint("check", "-w", f"ws{jobs}").code == 0
    assert reports[1]["steps"] == reports[2]["steps"] == reports[3]["steps"]
    assert reports[1] == reports[2] == reports[3]
    assert unsigned(tmp_path / "ws1") == unsigned(tmp_path / "ws2") == unsigned(tmp_path / "ws3")
    assert modes(tmp_path / "ws1") == modes(tmp_path / "ws2") == modes(tmp_path / "ws3")
    before = snapshot(tmp_path / "ws2")
    assert "nothing to do" in run(tmp_path, "provision", source, "-w", "ws2", "-j", 2).out
    assert snapshot(tmp_path / "ws2") == before


def test_a_system_with_no_room_for_another_process(keymint: Keymint, tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml")
    done = run(tmp_path, "provision", source, "-w", "ws", "-j", 3, program=NO_ROOM)
    assert done.code == 0, done.err
    assert keymint("check", "-w", "ws").code == 0


def test_each_stage_by_itself(keymint: Keymint, tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml")
    for jobs in (1, 2):
        assert keymint("init", f"ws{jobs}", "--policy", source).code == 0
        for verb in (("create", "--all"), ("build",), ("install",), ("build", "--rekey", "--yes", "*"), ("install",)):
            command = (*verb, "-w", f"ws{jobs}", "-j", jobs)
            done = keymint(*command) if jobs == 1 else run(tmp_path, *command)
            assert done.code == 0, done.err
        assert keymint("check", "-w", f"ws{jobs}").code == 0
    assert unsigned(tmp_path / "ws1") == unsigned(tmp_path / "ws2")


def test_the_errors_of_all_parts_together(keymint: Keymint, tmp_path: Path) -> None:
    bad = """<profile name="bad{n}"><attachment>/{n}</attachment><topic qualifier="ALLOW"><attachment>a</attachment>
        <partitions><partition>a[bc]</partition></partitions><permissions><publish/></permissions></topic></profile>"""
    source = policy(tmp_path / "policy.xml", extra=bad.format(n="a") + bad.format(n="z"))
    command = ("provision", source, "-w", "ws")
    one, two = keymint(*command, "-j", 1), run(tmp_path, *command, "-j", 2)
    assert one.code == two.code == 1
    assert one.err == two.err
    assert one.err.count("portably") == 2
    assert not (tmp_path / "ws").exists()


def test_a_refused_proof_is_explained_as_by_one_process(keymint: Keymint, tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml")
    assert keymint("provision", source, "-w", "ws", "-j", 1).code == 0
    for name in ("robot3", "robot17"):
        document = tmp_path / f"ws/build/{name}/talker/permissions.xml"
        document.write_text(document.read_text().replace("chatter", "secret_chatter"))
    before = snapshot(tmp_path / "ws")
    one, two = keymint("install", "-w", "ws", "-j", 1), run(tmp_path, "install", "-w", "ws", "-j", 2)
    assert one.code == two.code == 3
    assert one.err == two.err
    assert snapshot(tmp_path / "ws") == before


ENDED_BEFORE_STAGING = """
import os, signal, sys
from keymint.run import execution
from keymint.cli import main
from keymint.run.execution import Workers
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
stage = Workers.stage
def staged(self, *arguments):
    process = self._processes[-1]
    os.kill(process.pid, signal.SIGKILL)
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    return stage(self, *arguments)
Workers.stage = staged
sys.exit(main(sys.argv[1:]))
"""


def test_a_process_that_is_ended_between_planning_and_staging(keymint: Keymint, tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml")
    ended = run(tmp_path, "provision", source, "-w", "ws", "-j", 2, program=ENDED_BEFORE_STAGING)
    assert ended.code == 1, ended.err
    assert ended.err.count("\n") == 1
    assert "a process of this run ended before its work was done" in ended.err
    assert not list((tmp_path / "ws").rglob("key.pem"))
    assert keymint("provision", source, "-w", "ws", "-j", 1).code == 0
    assert keymint("check", "-w", "ws").code == 0


UNWRITTEN = """
import errno, os, sys
from keymint.run import execution
from keymint.cli import main
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
def sync_file_system(opened):
    raise OSError(errno.EIO, os.strerror(errno.EIO))
execution.sync_file_system = sync_file_system
sys.exit(main(sys.argv[1:]))
"""


def test_what_the_system_cannot_write_while_more_is_staged(keymint: Keymint, tmp_path: Path) -> None:
    """It tells that once only."""
    source = policy(tmp_path / "policy.xml")
    refused = run(tmp_path, "provision", source, "-w", "ws", "-j", 2, program=UNWRITTEN)
    assert refused.code == 1, refused.err
    assert refused.err == "ws/.keymint: error: cannot be written: Input/output error [write-failed]\n"
    found = [path.relative_to(tmp_path) for path in (tmp_path / "ws").rglob("*.pem")]
    assert not [path for path in found if ".keymint-" not in str(path)]
    assert keymint("provision", source, "-w", "ws", "-j", 1).code == 0
    assert keymint("check", "-w", "ws").code == 0


UNKNOWN_ANSWER = """
import sys
from keymint.cli import main
from keymint.errors import KeymintError
from keymint.run import execution, run
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
def next_answer(*_):
    raise KeymintError("is not known", code="unknown")
run.next_answer = next_answer
sys.exit(main(sys.argv[1:]))
"""


def test_an_error_while_others_stage_leaves_nothing_behind(keymint: Keymint, tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml")
    refused = run(tmp_path, "provision", source, "-w", "ws", "-j", 2, program=UNKNOWN_ANSWER)
    assert (refused.code, refused.err) == (1, "error: is not known [unknown]\n")
    assert not [*(tmp_path / "ws").rglob("key.pem"), *(tmp_path / "ws").rglob(".keymint-*")]
    assert keymint("provision", source, "-w", "ws", "-j", 1).code == 0
    assert keymint("check", "-w", "ws").code == 0


STOPPED_WHILE_OTHERS_STAGE = """
import os, signal, sys, time
import shutil  # before os.rmdir is another one
from keymint.run import execution, run
from keymint.__main__ import main
from keymint.store import file_writing
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
create, rmdir, parent = file_writing.create, os.rmdir, os.getpid()
def created(*arguments):
    if os.getpid() != parent:
        time.sleep(0.002)
    return create(*arguments)
def removed(*arguments, **options):
    time.sleep(0.01)  # the other process may write meanwhile
    rmdir(*arguments, **options)
def next_answer(*_):
    os.rmdir = removed
    os.kill(parent, signal.SIGTERM)
    time.sleep(1)  # the signal ends it
file_writing.create, run.next_answer = created, next_answer
sys.argv = ["keymint", *sys.argv[1:]]
main()
"""


def test_a_run_that_is_stopped_while_others_stage_leaves_nothing_behind(keymint: Keymint, tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml")
    stopped = run(tmp_path, "provision", source, "-w", "ws", "-j", 2, program=STOPPED_WHILE_OTHERS_STAGE)
    assert (stopped.code, stopped.err.count("\n")) == (128 + signal.SIGTERM, 1)
    assert not [*(tmp_path / "ws").rglob("key.pem"), *(tmp_path / "ws").rglob(".keymint-*")]
    assert keymint("provision", source, "-w", "ws", "-j", 1).code == 0
    assert keymint("check", "-w", "ws").code == 0


UNWRITTEN_FOR_ANOTHER = """
import os, sys
from pathlib import Path
from keymint.run import execution
from keymint.cli import main
from keymint.run.execution import Workers
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
stage, parent = Workers.stage, os.getpid()
def of_records():
    return {int(each.name) for each in Path("/proc/self/fd").iterdir() if os.path.realpath(each) == records}
def staged(self, *arguments):
    global before
    before = of_records()
    return stage(self, *arguments)
def sync_file_system(opened):
    assert os.getpid() != parent or opened in before
    Path("parent" if os.getpid() == parent else "other").touch()
    return True
records = os.path.abspath("ws/.keymint")
Workers.stage, execution.sync_file_system = staged, sync_file_system
sys.exit(main(sys.argv[1:]))
"""


def test_what_the_system_could_not_write_for_another_process(tmp_path: Path) -> None:
    """It tells who synchronises with what was open before; see syncfs(2)."""
    done = run(
        tmp_path, "provision", policy(tmp_path / "policy.xml"), "-w", "ws", "-j", 2, program=UNWRITTEN_FOR_ANOTHER
    )
    assert done.code == 0, done.err
    assert {path.name for path in tmp_path.iterdir()} >= {"other", "parent"}


SEEN_BY_GIT = """
import subprocess, sys
from pathlib import Path
from keymint.run import execution
from keymint.cli import main
from keymint.run.execution import Workers
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
stage = Workers.stage
def staged(self, *arguments):
    assert len([*Path("ws").rglob("enclaves")]) == 1 and not [*Path("ws").rglob("key.pem")]
    first = next(Path("ws").rglob("enclaves")).parent
    assert (first / ".gitignore").is_file(), "before the first secret"
    done = stage(self, *arguments)
    assert len([*Path("ws").rglob("key.pem")]) == 40
    subprocess.run(["git", "add", "-A"], check=True)
    return done
Workers.stage = staged
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_git_takes_no_key_that_processes_staged(tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    done = run(tmp_path, "provision", source, "-w", "ws", "-j", 2, program=SEEN_BY_GIT)
    assert done.code == 0, done.err
    added = subprocess.run(["git", "ls-files"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert "policy.xml" in added
    assert "key.pem" not in added


@pytest.mark.parametrize(
    ("stage", "name"), [("create", "robot8/talker"), ("install", "robot3/talker"), ("prove", "robot9/talker")]
)
def test_a_process_that_is_ended(keymint: Keymint, tmp_path: Path, stage: str, name: str) -> None:
    source = policy(tmp_path / "policy.xml")
    program = ENDED.format(stage=stage, name=name)
    ended = run(tmp_path, "provision", source, "-w", "ws", "-j", 2, program=program)
    assert ended.code == 1
    assert ended.err.count("\n") == 1
    assert "a process of this run ended before its work was done" in ended.err
    assert not (tmp_path / "ws").exists()
    assert keymint("provision", source, "-w", "ws", "-j", 1).code == 0
    assert keymint("check", "-w", "ws").code == 0


LEFT_TO_ALL = """
import sys
from keymint.run import execution
from keymint.cli import main
from keymint.stages.{module} import {stage}
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 4
new = {stage}.new
{stage}.new = lambda self, package: None if package.name in {names} else new(self, package)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("module", "stage"), [("build", "BuildStage"), ("install", "InstallStage"), ("prove", "ProofStage")]
)
def test_a_stage_may_look_at_a_new_package_as_at_any_other(
    keymint: Keymint, tmp_path: Path, module: str, stage: str
) -> None:
    source = policy(tmp_path / "policy.xml")
    program = LEFT_TO_ALL.format(module=module, stage=stage, names=("robot2/talker", "robot7/talker", "robot18/talker"))
    done = run(tmp_path, "provision", source, "-w", "two", "-j", 2, program=program)
    assert done.code == 0, done.err
    assert keymint("check", "-w", "two").code == 0
    assert keymint("provision", source, "-w", "one", "-j", 1).code == 0
    assert unsigned(tmp_path / "two") == unsigned(tmp_path / "one")
    assert modes(tmp_path / "two") == modes(tmp_path / "one")


FORGETTING = """
import gc, os, sys
from pathlib import Path
from comarmor import Policy
from keymint.run import execution, run
from keymint.cli import main
from keymint.view.tree import Tree
from keymint.workspace.session import Session
execution.MIN_PACKAGES, execution.MOST_PACKAGES = 10, 2
gc.disable()
count = lambda *kinds: sum(isinstance(each, kinds) for each in gc.get_objects())
planned, execute = execution._planned_in_parts, run.execute
def counted(*arguments):
    gc.unfreeze()
    before = count(Tree)
    changes = planned(*arguments)
    Path(f"kept-{os.getpid()}").write_text(str(count(Tree) - before))
    return changes
def executed(*arguments):
    Path("kept").write_text(str(count(Session, Policy)))
    return execute(*arguments)
execution._planned_in_parts, run.execute = counted, executed
sys.exit(main(sys.argv[1:]))
"""


def test_what_is_planned_is_forgotten(tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml")
    done = run(tmp_path, "provision", source, "-w", "ws", "-j", 2, program=FORGETTING)
    assert done.code == 0, done.err
    assert [path.read_text() for path in tmp_path.glob("kept*")] == ["0", "0"]


FILES = st.builds(File, st.binary(max_size=50), st.booleans())
CHANGES = st.builds(
    FolderChange,
    st.sampled_from([Path("/ws/src/a"), Path("/ws/install/b")]),
    st.dictionaries(st.sampled_from("abc"), FILES),
    st.just(("old",)),
    st.booleans(),
)


@given(st.lists(CHANGES, max_size=5))
def test_packed_changes_are_the_same(changes: list[FolderChange]) -> None:
    assert list(PackedChanges(changes)) == changes


def test_packed_changes_that_are_damaged_are_not_staged() -> None:
    packed = PackedChanges([FolderChange(Path("/ws/src/a"), {"a": File(b"permissions")})])
    packed._packed = packed._packed[:-5] + b"X" + packed._packed[-4:]
    with pytest.raises(ValueError, match="damaged in memory"):
        list(packed)


def test_no_key_is_in_one_text_with_other_files() -> None:
    secret = File(b"key of a", secret=True)
    packed = PackedChanges([FolderChange(Path("/ws/install/a"), {"key.pem": secret, "cert.pem": File(b"cert of a")})])
    assert b"key of a" not in zlib.decompress(packed._packed)
    assert next(iter(packed)).files["key.pem"] is secret


def test_no_private_key_leaves_its_process(tmp_path: Path) -> None:
    source, seen = policy(tmp_path / "policy.xml"), tmp_path / "seen"
    seen.mkdir()
    done = run(tmp_path, "provision", source, "-w", "ws", "-j", 2, program=SPY, SPY=str(seen))
    assert done.code == 0, done.err
    sent = b"".join(path.read_bytes() for path in seen.iterdir())
    assert b"robot8/talker" in sent
    keys = list((tmp_path / "ws/private").rglob("*.pem"))
    assert len(keys) == FEW + 2
    for path in keys:
        lines = re.findall(rb"^[A-Za-z0-9+/=]{20,}$", path.read_bytes(), re.MULTILINE)
        assert lines
        assert not any(line in sent for line in lines)


def test_an_interrupted_run_leaves_no_process_and_no_workspace(tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml", 400)
    command = [sys.executable, "-m", "keymint", "provision", str(source), "-w", "ws", "-j", "2"]
    process = subprocess.Popen(command, cwd=tmp_path, start_new_session=True, stderr=subprocess.PIPE, text=True)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while process.poll() is None and not (pids := children.read_text().split()):
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "Traceback" not in errors
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert not (tmp_path / "ws").exists()


SIGNALLED_WHILE_A_PROCESS_IS_FORKED = """
import os, signal, sys
from keymint.__main__ import main
fork = os.fork
def forked():
    number = fork()
    if number:
        print(number, flush=True)
        os.kill(os.getpid(), signal.SIGINT)
    return number
os.fork = forked
sys.argv = ["keymint", *sys.argv[1:]]
main()
"""


def test_a_signal_that_arrives_while_a_process_is_forked_ends_that_process_as_well(tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml", 400)
    arguments = ("provision", source, "-w", "ws", "-j", 2)
    ended = run(tmp_path, *arguments, program=SIGNALLED_WHILE_A_PROCESS_IS_FORKED)
    assert (ended.code, ended.err.count("\n")) == (130, 1)
    assert not Path(f"/proc/{ended.out.strip()}").exists()
    assert not (tmp_path / "ws").exists()


SIGNALLED_IN_A_FINALISER = """
import os, signal, sys
from keymint.stages import pipeline
from keymint.__main__ import main

class Dying:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):  # the handler runs between two instructions
            pass

conducted = pipeline._conducted

def signalled(*arguments):
    work = conducted(*arguments)
    Dying()
    return work

pipeline._conducted = signalled
sys.argv = ["keymint", *sys.argv[1:]]
main()
"""


def test_a_signal_that_arrives_in_a_finaliser_ends_the_run_before_it_writes(tmp_path: Path) -> None:
    source = policy(tmp_path / "policy.xml", 2)
    command = [sys.executable, "-c", SIGNALLED_IN_A_FINALISER, "provision", str(source), "-w", "ws"]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert process.returncode in {130, -signal.SIGINT}, process
    assert "Traceback" not in process.stderr
    assert not (tmp_path / "ws").exists()
