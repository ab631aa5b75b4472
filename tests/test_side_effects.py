# SPDX-License-Identifier: Apache-2.0
"""Who writes, who starts programs, and who reads the workspace: seen by an audit hook while all verbs run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import CHECKOUT

pytestmark = pytest.mark.xdist_group("audit")  # one worker, so that the verbs run once

WRITERS = "keymint/store/"
"""The only folder that writes files of a user. Its lock's time of change is the clock of the file system."""
TEMPORARY = {"keymint/host/vendor_process.py", "keymint/host/git.py", "keymint/verify/copies.py"}
"""Keep what a program says, trees of a revision, or enclaves for transports in temporary files that they remove."""
VENDORS = "plugins/keymint_ros2_dds/vendors/"
"""The only folder that builds and runs foreign programs; it writes to the cache only."""
STARTERS = {
    "keymint/host/vendor_process.py",
    "keymint/host/streams_and_signals.py",
    "keymint/host/git.py",
    "keymint/host/pool.py",
    "keymint/commands/tool/completion.py",
}
"""Run probes of the vendors, git, copies of this process, or the shell that the completion script is for."""
READERS = ("keymint/examine/", "keymint/stages/", "keymint/life/", "keymint/authority/", "keymint/verify/")

POLICY = "ws/profile/comarmor.d"
WRITING_VERBS = (
    ("init", "ws"),
    ("create", "--all", "-w", "ws"),
    ("build", "-w", "ws"),
    ("install", "-w", "ws"),
    ("build", "-w", "ws", "--rekey", "talker"),
    ("install", "-w", "ws", "--json"),
    ("install", "-w", "ws"),
    ("request", "talker", "--folder", "robot"),
    ("authority", "renew", "identity_ca", "-w", "ws"),
    ("authority", "replace", "identity_ca", "-w", "ws"),
    ("authority", "replace", "identity_ca", "--phase", "end", "-w", "ws"),
    ("authority", "export", "identity_ca", "-o", "ca.pem", "-w", "ws"),
    ("provision", POLICY, "-w", "ws2"),
    ("adopt", "ws2/install", POLICY, "--apply", "-w", "ws3"),
    ("graph", POLICY, "-o", "policy.svg"),
    ("graph", POLICY, "-o", "policy.html"),
    ("graph", POLICY, "-o", "policy.dot"),
    ("lint", POLICY, "--sarif", "lint.sarif"),
    ("test", str(CHECKOUT / "examples/fleet"), "--junit", "tests.xml"),
    ("fmt", "untidy"),
    ("learn", str(CHECKOUT / "examples/ppac_2018/graph.json"), "-o", "learned.xml"),
    ("import", "policy.xml", "-o", "imported"),
    ("export", POLICY, "--format", "sros2", "-o", "exported.xml"),
    ("query", POLICY, "who", "can", "publish", "/chatter"),
    ("diff", POLICY, f"HEAD:{POLICY}"),
    ("explain", "usage"),
    ("plugins",),
    ("transports",),
    ("completion", "bash"),
)
FOREIGN = """<policy version="0.2.0"><enclaves>
<enclave path="/a"><profiles><profile ns="/" node="a"/></profiles></enclave>
</enclaves></policy>"""
"""A policy of another tool."""
READING_VERBS = (
    ("check", "-w", "ws"),
    ("status", "-w", "ws"),
    ("env", "talker", "-w", "ws"),
    ("adopt", "ws/install"),
    ("harden", "-w", "ws"),
    ("learn", "--from-keystore", "ws/install"),
    ("authority", "show", "-w", "ws"),
    ("set", "valid-for", "P200D", "-w", "ws", "--dry-run"),
    ("remove", "--state", "revoked", "-w", "ws"),
    ("revoke", "talker", "--reason", "superseded", "-w", "ws"),
    ("revoke", "talker", "--reason", "key-compromise", "-w", "ws"),
    ("renew", "-w", "ws"),
    ("renew", "--rekey", "talker", "-w", "ws"),
    ("issued", "-w", "ws"),
    ("crl", "-w", "ws"),
    ("crl", "--refresh", "-w", "ws"),
    ("prove", "-w", "ws"),
    ("why", "-w", "ws", "/talker", "ros_publish", "/chatter"),
    ("verify", "-w", "ws", "-i", "omg", "-i", "cyclonedds-0.10", "-i", "fastdds-2.9", "--report", "report"),
    ("request", "listener", "--folder", "ws/install"),
    ("sign", "listener.request.pem", "-w", "ws"),
    ("accept", "listener.bundle", "--folder", "ws/install"),
    ("bundle", "listener", "-w", "ws"),
)


@dataclass(frozen=True)
class Event:
    """What a module of ours did: ``read``, ``write``, ``list`` or ``start``."""

    step: int
    kind: str
    path: str
    module: str


def audited(folder: Path, *steps: tuple[str, ...]) -> tuple[list[int], list[Event]]:
    """Run steps under the audit hook, and return their exit codes and what our modules did."""
    environment: Mapping[str, str] = {
        **{name: value for name, value in os.environ.items() if name != "KEYMINT_TRACEBACK"},
        "XDG_CACHE_HOME": str(folder / "cache"),
    }
    done = subprocess.run(
        [sys.executable, "-c", "from tests.audited import main; main()", folder],
        input=json.dumps(steps),
        cwd=CHECKOUT,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    answer = json.loads(done.stdout)
    return answer["codes"], [Event(*event) for event in answer["events"]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[int], list[Event]]:
    """All verbs, in a folder under version control."""
    folder = tmp_path_factory.mktemp("audited")
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    (folder / "policy.xml").write_text(FOREIGN)
    (folder / "untidy").mkdir()
    (folder / "untidy/p.xml").write_text("<profiles/>")
    codes, before = audited(folder, *WRITING_VERBS[:4])
    identity = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    subprocess.run(["git", "add", POLICY], cwd=folder, check=True)
    subprocess.run(["git", *identity, "commit", "-qm", "policy"], cwd=folder, check=True)
    more, after = audited(folder, *WRITING_VERBS[4:], *READING_VERBS)
    return codes + more, before + after


def test_all_verbs_ran(run: tuple[list[int], list[Event]]) -> None:
    codes, events = run
    assert codes == [0] * (len(WRITING_VERBS) + len(READING_VERBS))
    assert {event.kind for event in events} == {"read", "write", "list", "start"}


def test_only_the_store_writes(run: tuple[list[int], list[Event]]) -> None:
    writers = {event.module for event in run[1] if event.kind == "write"}
    assert {module for module in writers if not module.startswith((VENDORS, WRITERS))} <= TEMPORARY
    assert {"keymint/store/store.py", "keymint/store/file_writing.py"} <= writers


def test_only_git_and_the_vendors_start_programs(run: tuple[list[int], list[Event]]) -> None:
    starters = {event.module for event in run[1] if event.kind == "start"}
    assert {module for module in starters if not module.startswith(VENDORS)} <= STARTERS
    assert starters & STARTERS


KEYSTORES = ("ws/install/", "ws/private/", "ws/public/", "robot/")
"""Where installed files lie, below the folder of the run."""
OPENERS = {
    "keymint/view/file_reading.py", "keymint/view/recorded_answers.py", "keymint/view/tree.py",
    # It reads keystores of other tools, which are no workspace; the bytes by a reader that stays in a folder.
    "keymint/adoption/keystore_files.py", "comarmor/xml/sandboxed_paths.py",
}  # fmt: skip
"""The modules that open or list installed files, beside those that write them."""


def test_only_the_view_opens_installed_files(run: tuple[list[int], list[Event]]) -> None:
    opened = {
        event.module
        for event in run[1]
        if event.kind in {"read", "list"} and any(f"/{each}" in f"{event.path}/" for each in KEYSTORES)
    }
    openers = {module for module in opened if not module.startswith(("keymint/store/", VENDORS))}
    assert openers - OPENERS == set()
    assert {"keymint/view/file_reading.py", "keymint/view/tree.py"} <= openers


def test_verbs_that_read_see_only_their_snapshot(run: tuple[list[int], list[Event]]) -> None:
    first = len(WRITING_VERBS) - 4
    seen = {
        (event.module, event.path)
        for event in run[1]
        if event.step >= first
        and event.kind in {"read", "list"}
        and event.module.startswith(READERS)
        and event.module not in TEMPORARY
        and not event.path.endswith((".py", ".so"))
        and not event.path.startswith(sys.prefix)
        and "site-packages" not in event.path
        and not Path(event.path).is_relative_to(sys.base_prefix)
        and not Path(event.path).is_relative_to(CHECKOUT)
    }
    assert seen == set()
    assert any(
        event.module == "keymint/view/file_reading.py" and event.kind == "read"
        for event in run[1]
        if event.step >= first
    )


def test_a_module_that_writes_is_seen(tmp_path: Path) -> None:
    script = (
        "import os, sys\n"
        "from tests.audited import CHECKOUT, Recorder\n"
        "recorder = Recorder()\n"
        "sys.addaudithook(recorder)\n"
        "def ours(text): exec(compile(text, str(CHECKOUT / 'keymint' / 'new.py'), 'exec'), {'folder': sys.argv[1]})\n"
        "ours('import os; os.mkdir(folder + \"/a\")')\n"
        'ours(\'from pathlib import Path; Path(folder, "b").write_text("x")\')\n'
        'ours(\'import os; os.rename(folder + "/b", folder + "/c")\')\n'
        "ours('import tempfile; tempfile.mkdtemp(dir=folder)')\n"
        "ours('import subprocess; subprocess.run([\"true\"])')\n"
        "ours('import os; os.listdir(folder); open(folder + \"/c\").close()')\n"
        "open(sys.argv[1] + '/d', 'w').close()\n"
        "print([(kind, os.path.basename(path), module) for _, kind, path, module in recorder.events])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, tmp_path], cwd=CHECKOUT, capture_output=True, text=True, check=True
    )
    kinds = [(kind, name) for kind, name, module in eval(done.stdout) if module == "keymint/new.py"]
    for expected in (
        ("write", "a"),
        ("write", "b"),
        ("write", "b"),
        ("start", "true"),
        ("list", tmp_path.name),
        ("read", "c"),
    ):
        assert expected in kinds
    assert ("write", "d") not in kinds
