# SPDX-License-Identifier: Apache-2.0
"""Verbs that only look read their inputs at one moment, and hold no lock while they think about them."""

from __future__ import annotations

import contextlib
import fcntl
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from keymint.run import run
from keymint.workspace.session import Inputs
from keymint.workspace.workspace import Workspace

Keymint = Callable[..., Any]
POLICY = """<profiles>
  <profile name="talker"><attachment>/robot/talker</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="robot"><attachment>/robot</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
</profiles>"""
READERS = (
    ["check"],
    ["check", "robot/talker"],
    ["status"],
    ["prove"],
    ["verify", "-i", "omg", "-i", "fastdds-2.9"],
    ["why", "/robot/talker", "ros_publish", "/chatter", "-i", "omg"],
    ["why", "/robot/talker", "ros_subscribe", "/chatter", "-i", "omg"],
    ["install", "--dry-run"],
)


@pytest.fixture
def workspace(tmp_path: Path, keymint: Keymint) -> Path:
    (tmp_path / "policy.xml").write_text(POLICY)
    assert keymint("provision", tmp_path / "policy.xml", "-w", tmp_path / "ws").code == 0
    return tmp_path / "ws"


@pytest.fixture
def defective(workspace: Path, keymint: Keymint) -> Path:
    """Return a workspace in which every verb finds something: a policy that allows less, files that do not fit."""
    policy = workspace.parent / "policy.xml"
    policy.write_text(POLICY.replace("ros_publish", "ros_subscribe"))
    (workspace / "install/enclaves/robot/talker/governance.p7s").write_bytes(b"damaged")
    (workspace / "install/enclaves/robot/key.pem").chmod(0o644)
    (workspace / "install/enclaves/robot/README").write_bytes(b"a user's")
    (workspace / "build/robot/governance.xml").unlink()
    return workspace


@contextlib.contextmanager
def after_the_snapshot(monkeypatch: pytest.MonkeyPatch, do: Callable[[Path], None]) -> Iterator[list[Path]]:
    """Do something in the moment in which a verb has read its inputs."""
    real = run.Run.snapshot
    done: list[Path] = []

    def snapshot(self: run.Run, workspace: Workspace, *, auditing: bool = False) -> Inputs:
        inputs = real(self, workspace, auditing=auditing)
        done.append(workspace.root)
        do(workspace.root)
        return inputs

    with monkeypatch.context() as patch:
        patch.setattr(run.Run, "snapshot", snapshot)
        yield done


SPACES = ("private", "public", "src", "build", "install")


def take_away(workspace: Path) -> None:
    for space in SPACES:
        (workspace / space).rename(workspace / f"{space}.away")


def put_back(workspace: Path) -> None:
    for space in SPACES:
        (workspace / f"{space}.away").rename(workspace / space)


@pytest.mark.parametrize("state", ["workspace", "defective"])
@pytest.mark.parametrize("verb", READERS, ids=" ".join)
def test_what_is_looked_at_is_read_at_one_moment(
    state: str, verb: list[str], keymint: Keymint, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    workspace: Path = request.getfixturevalue(state)
    record = (workspace / ".keymint" / "state.json").read_bytes()
    plain = keymint(*verb, "-w", workspace, "--json")
    (workspace / ".keymint" / "state.json").write_bytes(record)
    with after_the_snapshot(monkeypatch, take_away) as done:
        blind = keymint(*verb, "-w", workspace, "--json")
    assert done == [workspace]
    put_back(workspace)
    assert same_keys(blind.out).splitlines() == same_keys(plain.out).splitlines()
    assert blind.code == plain.code
    assert str(workspace) not in blind.out or str(workspace) in plain.out
    assert "/keymint-" not in blind.out  # a copy's folder


def same_keys(text: str) -> str:
    return re.sub(r"inum \d+", "inum", text)


@pytest.mark.parametrize("verb", READERS, ids=" ".join)
def test_no_lock_is_held_while_a_verb_thinks(
    verb: list[str], workspace: Path, keymint: Keymint, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lock(root: Path) -> None:
        with (root / ".keymint" / "lock").open("r+") as opened:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)

    with after_the_snapshot(monkeypatch, lock) as done:
        assert keymint(*verb, "-w", workspace).code in {0, 3}
    assert done == [workspace]


@pytest.mark.parametrize("verb", READERS, ids=" ".join)
def test_a_tree_that_nobody_can_write_is_no_error(verb: list[str], workspace: Path, keymint: Keymint) -> None:
    plain = keymint(*verb, "-w", workspace)
    ran = subprocess.run(["mount", "--bind", "-o", "ro", workspace, workspace], capture_output=True, check=False)
    if ran.returncode:
        pytest.skip(f"cannot mount: {ran.stderr.decode().strip()}")
    try:
        if subprocess.run(["touch", workspace / "x"], capture_output=True, check=False).returncode == 0:
            pytest.skip("the machine mounts nothing read-only")
        read_only = keymint(*verb, "-w", workspace)
    finally:
        subprocess.run(["umount", workspace], check=True)
    assert (read_only.code, read_only.err) == (plain.code, plain.err)


@pytest.mark.parametrize("verb", READERS, ids=" ".join)
def test_a_copy_without_a_lock_is_no_error_and_gets_none(verb: list[str], workspace: Path, keymint: Keymint) -> None:
    plain = keymint(*verb, "-w", workspace)
    (workspace / ".keymint" / "lock").unlink()
    looked = keymint(*verb, "-w", workspace)
    assert (looked.code, looked.err) == (plain.code, plain.err)
    assert not (workspace / ".keymint" / "lock").exists()


def stamps(workspace: Path) -> bytes:
    return (workspace / ".keymint" / "state.json").read_bytes()


def forget_proofs(workspace: Path, keymint: Keymint) -> None:
    """Install without proofs, so that 'prove' has something to record."""
    policy = workspace.parent / "policy.xml"
    policy.write_text(POLICY.replace("/chatter", "/other"))
    assert keymint("provision", policy, "-w", workspace, "--no-prove").code == 0


def test_what_was_proven_is_recorded(workspace: Path, keymint: Keymint) -> None:
    forget_proofs(workspace, keymint)
    before = stamps(workspace)
    assert keymint("prove", "-w", workspace, "--dry-run").code == 0
    assert stamps(workspace) == before
    assert keymint("prove", "-w", workspace).code == 0
    assert stamps(workspace) != before
    assert "2 cached" in keymint("prove", "-w", workspace).out


def test_what_was_proven_is_not_recorded_over_what_somebody_did_meanwhile(
    workspace: Path, keymint: Keymint, monkeypatch: pytest.MonkeyPatch
) -> None:
    forget_proofs(workspace, keymint)
    seen: list[bytes] = []

    def renew(root: Path) -> None:
        if not seen:
            seen.append(b"")
            arguments = ("provision", root.parent / "policy.xml", "-w", root, "--no-prove", "--rekey=*", "--yes")
            assert keymint(*arguments).code == 0
            seen.append(stamps(root))

    with after_the_snapshot(monkeypatch, renew):
        assert keymint("prove", "-w", workspace).code == 0
    assert stamps(workspace) == seen[1]
    assert keymint("check", "-w", workspace).code == 0


def test_a_killed_run_keeps_its_mark_when_something_is_proven(workspace: Path, keymint: Keymint) -> None:
    forget_proofs(workspace, keymint)
    (workspace / ".keymint" / "running").write_bytes(b"0123")
    before = stamps(workspace)
    assert keymint("prove", "-w", workspace).code == 0
    assert (workspace / ".keymint" / "running").read_bytes() == b"0123"
    assert stamps(workspace) == before


def test_transports_read_copies_that_go_at_the_end_and_private_keys_only_where_they_must(
    workspace: Path, keymint: Keymint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "tmp").mkdir()
    seen: list[Path] = []
    from keymint.verify.compare import TransportComparison

    real = TransportComparison.all_endpoints

    def watched(*arguments: Any) -> Any:
        seen.extend((tmp_path / "tmp").rglob("*"))
        assert all(path.stat().st_mode & 0o077 == 0 for path in (tmp_path / "tmp").iterdir())
        return real(*arguments)

    monkeypatch.setattr(TransportComparison, "all_endpoints", watched)
    assert keymint("verify", "-w", workspace, "-i", "omg").code == 0
    assert {path.name for path in seen} >= {"permissions.p7s", "cert.pem"}
    assert "key.pem" not in {path.name for path in seen}
    assert list((tmp_path / "tmp").iterdir()) == []
