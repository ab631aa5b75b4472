# SPDX-License-Identifier: Apache-2.0
"""After a change, only packages that it may concern are looked at; what comes of it is the same as if all were."""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from keymint.commands.start import provision as command
from keymint.errors import KeymintError
from keymint.stages import pipeline
from keymint.store.changes import Action
from keymint.workspace import policy_loading
from tests.conftest import NOW
from tests.effort import tries

PROFILE = """  <profile name="{name}">
    <attachment>/{name}</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/fleet/{topic}</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
  </profile>
"""
NAMES = ("camera", "robot/arm", "robot/gripper")


def policy(topics: dict[str, str], beginning: str = "") -> str:
    profiles = (PROFILE.format(name=name, topic=topic) for name, topic in topics.items())
    return f"<profiles>\n{beginning}{''.join(profiles)}</profiles>\n"


SAME = dict.fromkeys(NAMES, "map")
LESS = dict.fromkeys(("camera", "robot/gripper"), "map")


class Compared:
    """Plans each run twice, and compares: with the packages that nothing changed for, and as if there were none.

    Attributes:
        looked: the packages that stages looked at in the last run; None before.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.looked: set[str] | None = None
        self._settled = pipeline._settled
        self._monkeypatch = monkeypatch
        monkeypatch.setattr(command, "conduct", self._both)

    def _both(self, *arguments: Any) -> Any:
        whole = self._planned(lambda *_: frozenset(), *arguments)
        quick = self._planned(self._recorded, *arguments)
        assert self._told(quick) == self._told(whole)
        if isinstance(quick, KeymintError):
            raise quick
        return quick

    def _recorded(self, work: Any, names: Sequence[str], create: Any) -> frozenset[str]:
        settled = self._settled(work, names, create)
        self.looked = {*names} - settled
        return settled

    def _planned(self, settled: Callable[..., Collection[str]], *arguments: Any) -> Any:
        with self._monkeypatch.context() as patch:
            patch.setattr(pipeline, "_settled", settled)
            try:
                return pipeline.conduct(*arguments)
            except KeymintError as error:
                return error

    @staticmethod
    def _told(work: Any) -> object:
        """Return all that a user sees of a plan, and what is recorded of packages; new keys and signatures differ."""
        if isinstance(work, KeymintError):
            return work.diagnostics, work.exit_code
        changes = ([(at.folder, {*at.written}, at.removed) for at in each.changes] for each in work.plan.steps)
        steps = [(each.stage, each.package, each.action, each.detail) for each in work.plan.steps]
        changing = {each.package for each in work.plan.steps if each.writes()}
        state = {
            stage: {n: s for n, s in of.items() if n not in changing} for stage, of in work.plan.state.stamps.items()
        }
        return steps, [*changes], work.plan.diagnostics, state


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch) -> Iterator[Compared]:
    """Compare each plan of 'provision' with that of a run which looks at everything."""
    return Compared(monkeypatch)


@pytest.fixture
def provision(keymint, tmp_path: Path, compared: Compared) -> Callable[..., Any]:
    """Provision a workspace, and return what does it again with the same command."""
    (tmp_path / "policy.xml").write_text(policy(SAME))

    def run(*options: object, **named: Any) -> Any:
        time.sleep(0.03)  # what was just written is older than the run
        compared.looked = None
        return keymint("provision", "policy.xml", "-w", "ws", *options, **named)

    assert run().code == 0
    return run


def append(path: Path, text: str = "<!-- by hand -->\n") -> None:
    path.write_text(path.read_text() + text)


def rewritten(path: Path) -> None:
    """Put a file with the same content and time of modification in the place of another one."""
    before, content = path.stat(), path.read_bytes()
    path.with_name("new").write_bytes(content)
    path.with_name("new").rename(path)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def copied(path: Path) -> None:
    """Put a copy of a folder, with all times, in its place."""
    path.rename(path.with_name("former"))
    shutil.copytree(path.with_name("former"), path, symlinks=True)
    shutil.rmtree(path.with_name("former"))


def restored(path: Path) -> None:
    """Put back an older version of a file with its time of modification."""
    before = path.stat()
    append(path)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


ALL = frozenset(NAMES)
ARM = frozenset({"robot/arm"})
NONE: frozenset[str] = frozenset()
ENCLAVE = "ws/install/enclaves/robot/arm"
TOUCHES: dict[str, tuple[Callable[[Path], object], Collection[str]]] = {
    "a rule": (lambda at: (at / "policy.xml").write_text(policy(SAME | {"robot/arm": "pose"})), ARM),
    "places of rules": (lambda at: (at / "policy.xml").write_text(policy(SAME, "\n\n")), NONE),
    "a subject more": (lambda at: (at / "policy.xml").write_text(policy(SAME | {"lidar": "scan"})), {"lidar"}),
    "a subject less": (lambda at: (at / "policy.xml").write_text(policy(LESS)), ARM),
    "a source by hand": (lambda at: append(at / "ws/src/robot/arm/permissions.xml"), ARM),
    "a source more": (lambda at: (at / "ws/src/robot/arm/more.xml").write_text("<more/>"), ARM),
    "a source less": (lambda at: (at / "ws/src/robot/arm/permissions.xml").unlink(), ARM),
    "a mode of sources": (lambda at: (at / "ws/src/robot/arm").chmod(0o700), ARM),
    "defaults of a package": (
        lambda at: shutil.copytree(at / "ws/profile/package.defaults", at / "ws/src/robot/arm/package.defaults"), ARM,
    ),
    "a hidden folder of packages": (lambda at: (at / "ws/src/robot/KEYMINT_IGNORE").write_text(""), NONE),
    "a package less": (lambda at: shutil.rmtree(at / "ws/src/robot/arm"), ARM),
    "a copied package": (lambda at: copied(at / "ws/src/robot/arm"), ARM),
    "a document by hand": (lambda at: append(at / "ws/build/robot/arm/permissions.xml"), ARM),
    "a document less": (lambda at: (at / "ws/build/robot/arm/permissions.xml").unlink(), ARM),
    "an installed file by hand": (lambda at: append(at / ENCLAVE / "permissions.xml"), ARM),
    "an installed file, restored": (lambda at: restored(at / ENCLAVE / "permissions.xml"), ARM),
    "an installed file, rewritten": (lambda at: rewritten(at / ENCLAVE / "cert.pem"), ARM),
    "an installed file less": (lambda at: (at / ENCLAVE / "governance.p7s").unlink(), ARM),
    "an installed mode": (lambda at: (at / ENCLAVE / "key.pem").chmod(0o644), ARM),
    "an enclave less": (lambda at: shutil.rmtree(at / ENCLAVE), ARM),
    "an enclave more": (lambda at: shutil.copytree(at / ENCLAVE, at / "ws/install/enclaves/copy"), NONE),
    "another authority in an enclave": (
        lambda at: (at / ENCLAVE / "identity_ca.cert.pem").write_bytes((at / ENCLAVE / "cert.pem").read_bytes()), ARM,
    ),
    "a key less": (lambda at: (at / "ws/private/identities/robot/arm/key.pem").unlink(), ARM),
    "a shared file less": (lambda at: (at / "ws/install/enclaves/governance.p7s").unlink(), NONE),
    "a shared file by hand": (lambda at: append(at / "ws/install/public/identity_ca.cert.pem"), NONE),
    "the profile": (lambda at: append(at / "ws/profile/keymint_profile.xml"), ALL),
    "the defaults of governance": (lambda at: append(at / "ws/profile/package.defaults/governance.xml"), ALL),
    "an authority": (lambda at: append(at / "ws/public/identity_ca.cert.pem", "\n"), ALL),
    "the key of an authority less": (lambda at: (at / "ws/private/identity_ca.key.pem").unlink(), ALL),
    "the register less": (lambda at: (at / "ws/private/register.sqlite3").unlink(), ALL),
    "the record less": (lambda at: (at / "ws/.keymint/state.json").unlink(), ALL),
    "the answer by hand": (lambda at: append(at / "ws/.keymint/last-provision.json", "x"), ALL),
    "a copied workspace": (lambda at: copied(at / "ws"), ALL),
}  # fmt: skip


@pytest.mark.parametrize(("touch", "looked"), TOUCHES.values(), ids=TOUCHES)
def test_what_comes_of_a_change_is_the_same_as_if_all_were_looked_at(
    provision: Callable[..., Any], tmp_path: Path, compared: Compared,
    touch: Callable[[Path], object], looked: Collection[str],
) -> None:  # fmt: skip
    touch(tmp_path)
    outcome = provision()
    assert compared.looked == looked
    require_done(provision, tmp_path, outcome)


def require_done(provision: Callable[..., Any], at: Path, outcome: Any) -> None:
    """Require that nothing is left to do, for a run without the record of the last one."""
    (at / "ws/.keymint/last-provision.json").unlink(missing_ok=True)
    again = provision("--json")
    if outcome.code == 0:
        assert {each["action"] for each in again.document["steps"]} <= {Action.UNCHANGED, Action.KEPT}
    else:
        assert again.code == outcome.code


@pytest.mark.parametrize(
    ("options", "env"),
    [
        (("--prune",), {}),
        (("--no-optimise",), {}),
        ((), {"SOURCE_DATE_EPOCH": str(NOW - 1)}),
        ((), {"SOURCE_DATE_EPOCH": str(NOW + 20 * 365 * 86_400)}),
        ((), {"ROS_DISTRO": "humble"}),
    ],
)
def test_another_command_looks_at_all(
    provision: Callable[..., Any], tmp_path: Path, compared: Compared, options: Sequence[str], env: dict[str, str]
) -> None:
    TOUCHES["a rule"][0](tmp_path)
    provision(*options, env=env)
    assert compared.looked == ALL


def test_another_version_looks_at_all(
    provision: Callable[..., Any], tmp_path: Path, compared: Compared, monkeypatch: pytest.MonkeyPatch
) -> None:
    TOUCHES["a rule"][0](tmp_path)
    monkeypatch.setattr("keymint.view.recorded_answers.__version__", "0.0")
    provision()
    assert compared.looked == ALL


def test_what_a_run_warned_of_is_told_again(provision: Callable[..., Any], tmp_path: Path, compared: Compared) -> None:
    TOUCHES["an enclave more"][0](tmp_path)
    told = provision().err
    assert "has no source package" in told
    TOUCHES["places of rules"][0](tmp_path)
    assert provision().err == told
    assert compared.looked == NONE
    TOUCHES["a rule"][0](tmp_path)
    assert told in provision().err
    assert compared.looked == ARM
    (tmp_path / "policy.xml").write_text(policy(SAME | {"robot/arm": "pose"}, "\n\n"))
    assert provision().err == told
    assert compared.looked == NONE


def test_changes_one_after_the_other(provision: Callable[..., Any], tmp_path: Path, compared: Compared) -> None:
    for topic in ("pose", "map", "pose"):
        (tmp_path / "policy.xml").write_text(policy(SAME | {"robot/arm": topic}))
        assert provision().code == 0
        assert compared.looked == ARM


@settings(max_examples=tries(8, 200), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rounds=st.lists(st.lists(st.sampled_from(sorted(TOUCHES)), min_size=1, max_size=3), min_size=1, max_size=3))
def test_any_changes(
    provision: Callable[..., Any], tmp_path: Path, compared: Compared, rounds: list[list[str]]
) -> None:
    shutil.rmtree(tmp_path / "ws")
    (tmp_path / "policy.xml").write_text(policy(SAME))
    assert provision().code == 0
    outcome = None
    for touches in rounds:
        for touch in touches:
            with contextlib.suppress(OSError):  # another one removed the file
                TOUCHES[touch][0](tmp_path)
        outcome = provision()
    require_done(provision, tmp_path, outcome)


WILD = """<profiles>
  <profile name="all">
    <attachment>/*</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/fleet/{topic}</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
  </profile>
</profiles>
"""


def test_a_package_that_was_away_follows_the_policy_when_it_is_back(keymint, tmp_path: Path) -> None:
    """That all packages follow the policy was not recorded of this one."""
    file, arm = tmp_path / "policy.xml", tmp_path / "ws/src/arm"
    file.write_text(WILD.format(topic="map"))
    keymint("init", "-w", "ws", "--policy", "policy.xml")
    for name in ("arm", "gripper"):
        assert keymint("create", name, "-w", "ws").code == 0
    arm.rename(tmp_path / "arm")
    file.write_text(WILD.format(topic="pose"))
    assert keymint("create", "--all", "-w", "ws").code == 0
    (tmp_path / "arm").rename(arm)
    assert keymint("create", "--all", "-w", "ws").code == 0
    assert "pose" in (arm / "permissions.xml").read_text()


def test_the_policy_is_not_loaded_while_all_packages_follow_it(
    provision: Callable[..., Any], keymint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    TOUCHES["a subject more"][0](tmp_path)
    assert provision().code == 0
    loaded: list[object] = []
    monkeypatch.setattr(policy_loading, "_load", lambda *arguments: loaded.append(arguments))
    assert keymint("status", "-w", "ws").code == 0
    assert not loaded
