# SPDX-License-Identifier: Apache-2.0
"""A command that nothing changed for is answered from its record, exactly as if it were carried out."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from keymint.run import execution
from keymint.view import recorded_answers
from tests.conftest import CHECKOUT, NOW, Outcome, snapshot

EXAMPLES = CHECKOUT / "examples"
POLICIES = {
    "talker_listener": ("talker_listener/talker_listener.xml",),
    "add_two_ints": ("add_two_ints/add_two_ints.xml",),
    "action": ("action/fibonacci.xml",),
    "fleet": ("fleet",),
    "ppac_2018": ("ppac_2018/policy.xml", "--allow-vendor-specific", "--no-prove"),
    "zenoh": ("talker_listener/talker_listener.xml", "--transport", "zenoh"),
    "ardent": ("talker_listener/talker_listener.xml", "--distro", "ardent"),
}


@pytest.fixture
def recalled(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Tell of each command whether it was answered from its record."""
    answers: list[bool] = []

    before = recorded_answers.recall

    def recall(call: recorded_answers.Call) -> recorded_answers.Answer | None:
        answer = before(call)
        answers.append(answer is not None)
        return answer

    monkeypatch.setattr(recorded_answers, "recall", recall)
    return answers


def settle() -> None:
    """Wait until files that were just written are older than the next run."""
    time.sleep(0.03)


def carried_out(keymint: Callable[..., Outcome], workspace: Path, *arguments: object, **named: Any) -> Outcome:
    """Carry out a command that could be answered from its record."""
    for record in (workspace / ".keymint").glob("last-*.json"):
        record.unlink()
    return keymint(*arguments, **named)


@pytest.mark.parametrize("options", [(), ("--json",), ("-vv",), ("-q",)], ids=" ".join)
@pytest.mark.parametrize("policy", POLICIES)
def test_the_answer_is_what_carrying_it_out_prints(
    keymint, recalled: list[bool], tmp_path: Path, policy: str, options: tuple[str, ...]
) -> None:
    source, *others = POLICIES[policy]
    shutil.copytree(EXAMPLES / source, tmp_path / "p") if (EXAMPLES / source).is_dir() else shutil.copy(
        EXAMPLES / source, tmp_path / "p"
    )
    command = ("provision", "p", "-w", "ws", *others, *options)
    settle()
    first = keymint(*command)
    assert first.code == 0, first.err
    second = keymint(*command)
    # After a run with diagnostics, or with documents that all packages share, the second one is carried out; not if the
    # diagnostics are about packages that were new.
    told = keymint("provision", "p", "-w", "other", *others, "--json").document["diagnostics"]
    certain = {each["code"] for each in told} <= {"node-cannot-start", "parameter-client-cannot-start"}
    assert recalled[:2] == [False, certain and policy != "zenoh"]
    recalled.clear()
    third = keymint(*command)
    assert recalled == [True]
    assert second == third == carried_out(keymint, tmp_path / "ws", *command)
    assert recalled == [True, False]


@pytest.mark.parametrize("options", [(), ("--json",)], ids=" ".join)
def test_stage_by_stage(keymint, recalled: list[bool], just_provisioned: Path, options: tuple[str, ...]) -> None:
    for command in (("create", "--all"), ("build",), ("install",), ("install", "talker", "--no-prove")):
        settle()
        given = (*command, *options)
        outcomes = [keymint(*given, cwd=just_provisioned) for _ in range(2)]
        assert recalled[-2:] == [False, True]
        assert outcomes[0] == outcomes[1]


def test_it_holds_inside_of_the_workspace_only_while_no_other_one_is_nearer(
    keymint, recalled: list[bool], just_provisioned: Path
) -> None:
    settle()
    for expected in (False, True):
        keymint("build", cwd=just_provisioned / "src")
        assert recalled[-1] == expected
    keymint("build", cwd=just_provisioned / "src/talker")
    assert not recalled[-1]
    (just_provisioned / "src/profile").mkdir()
    (just_provisioned / "src/profile/keymint_profile.xml").write_text("<profile/>")
    assert keymint("build", cwd=just_provisioned / "src").code != 0
    assert not recalled[-1]


@pytest.mark.parametrize(
    "options", [(), ("--json",), ("--format", "openmetrics"), ("-q",), ("--strict",)], ids=" ".join
)
def test_a_status_is_told_again_until_a_day_less_is_left(
    keymint, recalled: list[bool], policy: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    command = ("status", "-w", "ws", *options)
    keymint("provision", policy, "-w", "ws")
    settle()
    first = keymint(*command, env=at(NOW + 100))
    until = int(json.loads((tmp_path / "ws/.keymint/last-status.json").read_bytes().splitlines()[0])["until"])
    assert NOW + 100 < until < NOW + 86_500
    for moment in (NOW + 100, until - 1):
        told = keymint(*command, env=at(moment))
        assert recalled[-1]
        assert told == first == carried_out(keymint, tmp_path / "ws", *command, env=at(moment))
    last = keymint(*command, env=at(until + 1))
    assert not recalled[-1]
    assert (last.code, last.out != first.out) == (0, not options or options == ("--strict",))


def test_a_status_with_a_note_or_of_changed_files_is_carried_out(
    keymint, recalled: list[bool], just_provisioned: Path
) -> None:
    settle()
    for expected in (False, True):
        assert "install" in keymint("status", cwd=just_provisioned, env=at(NOW + 1)).out
        assert recalled[-1] == expected
    edit(just_provisioned / "install/enclaves/talker/governance.p7s")
    for _ in range(2):
        assert keymint("status", cwd=just_provisioned, env=at(NOW + 1)).out.count("  install  ") == 1
        settle()
    (just_provisioned / "private/identity_ca.key.pem").unlink()
    settle()
    for _ in range(2):
        assert "note: " in keymint("status", cwd=just_provisioned, env=at(NOW + 1)).err
        assert not recalled[-1]


# -- what undoes it --------------------------------------------------------------------------------------------------


def edit(path: Path) -> None:
    """Change a byte, and hide that: size and time of modification stay."""
    before, content = path.stat(), bytearray(path.read_bytes())
    content[-3] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def link(path: Path) -> None:
    elsewhere = path.parents[2] / path.name
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def rewrite(path: Path) -> None:
    """Write the same content into a new file."""
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)


def relink(at: Path) -> None:
    (at / "policy.xml").rename(at / "other.xml")
    (at / "policy.xml").symlink_to("other.xml")


def include(at: Path) -> None:
    (at / "common").mkdir()
    (at / "common/node.xml").write_text("<x/>")


INSTALLED = "ws/install/enclaves/talker"
TOUCHES: dict[str, Callable[[Path], object]] = {
    "a source": lambda at: edit(at / "ws/src/talker/permissions.xml"),
    "a built document": lambda at: edit(at / "ws/build/talker/permissions.xml"),
    "an installed file": lambda at: edit(at / INSTALLED / "governance.p7s"),
    "a certificate": lambda at: edit(at / "ws/public/identity_ca.cert.pem"),
    "the profile": lambda at: edit(at / "ws/profile/keymint_profile.xml"),
    "the policy": lambda at: edit(at / "policy.xml"),
    "the policy, in another file": lambda at: rewrite(at / "policy.xml"),
    "a link in place of the policy": relink,
    "an include that now exists": include,
    "a mode": lambda at: (at / INSTALLED / "key.pem").chmod(0o644),
    "a mode of a folder": lambda at: (at / "ws/private").chmod(0o755),
    "a link": lambda at: link(at / INSTALLED / "cert.pem"),
    "a file more": lambda at: (at / "ws/src/talker/more.xml").write_text("<more/>"),
    "a file in an empty folder": lambda at: (at / "ws/src/KEYMINT_IGNORE").write_text(""),
    "a file less": lambda at: (at / INSTALLED / "permissions.p7s").unlink(),
    "a package less": lambda at: shutil.rmtree(at / "ws/src/talker"),
    "an enclave more": lambda at: shutil.copytree(at / INSTALLED, at / "ws/install/enclaves/copy"),
    "no record": lambda at: (at / "ws/.keymint/state.json").unlink(),
    "a killed run": lambda at: (at / "ws/.keymint/running").write_text(""),
    "a damaged answer": lambda at: edit(at / "ws/.keymint/last-provision.json"),
    "a .gitignore less": lambda at: (at / "ws/build/.gitignore").unlink(),
}


@pytest.mark.parametrize("touch", TOUCHES.values(), ids=TOUCHES)
def test_whatever_changed_the_command_is_carried_out(
    keymint, recalled: list[bool], policy: Path, tmp_path: Path, touch: Callable[[Path], object]
) -> None:
    settle()
    command = ("provision", policy, "-w", "ws")
    for expected in (False, True):
        assert keymint(*command).code == 0
        assert recalled[-1] == expected
    touch(tmp_path)
    keymint(*command)
    assert not recalled[-1]


@pytest.mark.parametrize(
    ("arguments", "env"),
    [
        (("-v",), {}),
        (("--force",), {}),
        (("--prune",), {}),
        ((), {"SOURCE_DATE_EPOCH": str(NOW - 1)}),
        ((), {"SOURCE_DATE_EPOCH": str(NOW + 20 * 365 * 86_400)}),
        ((), {"ROS_DISTRO": "humble"}),
    ],
)
def test_another_command_is_carried_out(
    keymint, recalled: list[bool], policy: Path, arguments: tuple[str, ...], env: dict[str, str]
) -> None:
    settle()
    for expected in (False, True):
        keymint("provision", policy, "-w", "ws")
        assert recalled[-1] == expected
    keymint("provision", policy, "-w", "ws", *arguments, env=env)
    assert not recalled[-1]


def test_what_does_something_each_time_is_always_carried_out(keymint, recalled: list[bool], policy: Path) -> None:
    settle()
    for option in ("--rekey=/talker", "--force", "--new-authority=identity_ca"):
        for _ in range(3):
            keymint("provision", policy, "-w", "ws", option)
    assert not any(recalled)


@pytest.mark.parametrize("meanwhile", [False, True], ids=["after it", "while it is carried out"])
def test_a_command_is_carried_out_again_if_a_plugin_is_installed(
    keymint, recalled: list[bool], just_provisioned: Path, monkeypatch: pytest.MonkeyPatch, *, meanwhile: bool
) -> None:
    metadata = just_provisioned.parent / "software/new-1.dist-info"
    metadata.mkdir(parents=True)
    monkeypatch.syspath_prepend(metadata.parent)
    before = execution.record

    def install(*arguments: Any) -> bytes | None:
        (metadata / "entry_points.txt").write_text("[keymint.policy_formats]\nnew = nowhere:nothing\n")
        return before(*arguments) if arguments else None

    settle()
    if meanwhile:
        monkeypatch.setattr(execution, "record", install)
    for expected in (False, not meanwhile):
        keymint("build", cwd=just_provisioned)
        assert recalled[-1] == expected
    install()
    keymint("build", cwd=just_provisioned)
    assert not recalled[-1]


def test_a_command_is_carried_out_once_a_certificate_expired(keymint, recalled: list[bool], policy: Path) -> None:
    settle()
    command = ("provision", policy, "-w", "ws")
    keymint(*command)
    (expired,) = re.findall(r"the certificate expired on ([0-9T:-]+)Z", keymint(*command, env=at(NOW * 2)).err)[:1]
    last = int(datetime.fromisoformat(f"{expired}+00:00").timestamp())
    for moment, carried_out_again in ((NOW, True), (NOW + 1, False), (last - 1, False), (last + 1, True)):
        outcome = keymint(*command, env=at(moment))
        assert recalled[-1] != carried_out_again
        assert (expired in outcome.err) == (moment > last)


def at(moment: int) -> dict[str, str]:
    """Return the variable that sets the clock."""
    return {"SOURCE_DATE_EPOCH": str(moment)}


def test_a_warning_beside_a_change_is_not_told_from_the_record(
    keymint, recalled: list[bool], policy: Path, tmp_path: Path
) -> None:
    settle()
    command = ("provision", policy, "-w", "ws")
    keymint(*command)
    enclave = next((tmp_path / "ws/install").rglob("cert.pem")).parent
    shutil.copytree(enclave, enclave.parent / "stray")
    next((tmp_path / "ws/build").rglob("permissions.xml")).unlink()
    settle()
    told = []
    for is_recalled in (False, False, True):
        told.append(keymint(*command).err)
        assert recalled[-1] is is_recalled
        settle()
    assert all("stray" in err for err in told)


def test_an_answer_writes_nothing(keymint, recalled: list[bool], policy: Path, tmp_path: Path) -> None:
    settle()
    keymint("provision", policy, "-w", "ws")
    before = snapshot(tmp_path), (tmp_path / "ws/.keymint").stat()
    keymint("provision", policy, "-w", "ws")
    assert recalled == [False, True]
    assert (snapshot(tmp_path), (tmp_path / "ws/.keymint").stat()) == before


def test_what_the_user_may_not_keep_is_not_recorded(keymint, policy: Path, tmp_path: Path) -> None:
    """No value of a variable is in the record."""
    settle()
    keymint("provision", policy, "-w", "ws", env={"ROS_DISTRO": "humble"})
    assert "humble" not in (tmp_path / "ws/.keymint/last-provision.json").read_text()


def test_neither_xml_nor_cryptography_is_loaded(policy: Path, tmp_path: Path) -> None:
    settle()
    program = (
        "import sys; from keymint import cli; code = cli.main(sys.argv[1:]);"
        "print(code, 'lxml' in sys.modules, 'cryptography' in sys.modules)"
    )
    for expected in ("0 True True", "0 False False"):
        done = subprocess.run(
            [sys.executable, "-c", program, "provision", str(policy), "-w", "ws"],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert done.stdout.splitlines()[-1] == expected
    assert "nothing to do: 2 packages up to date" in done.stdout
