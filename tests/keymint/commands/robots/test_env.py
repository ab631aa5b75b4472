# SPDX-License-Identifier: Apache-2.0
"""``keymint env``."""

from __future__ import annotations

import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from keymint import cli
from keymint.host.streams_and_signals import StoppedError
from tests.conftest import snapshot


def test_a_shell_takes_it(keymint, ws: Path, tmp_path: Path) -> None:
    moved = tmp_path / "it's $HOME"
    shutil.move(ws, moved)
    (tmp_path / "lines").write_text(keymint("env", "/robot1/listener", "-w", moved).out)
    show = 'eval "$(cat lines)"; printf "%s|" "$ROS_SECURITY_KEYSTORE" "$ROS_SECURITY_ENCLAVE_OVERRIDE"'
    done = subprocess.run(["bash", "-c", show], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == f"{moved}/install|/robot1/listener|"


@pytest.mark.parametrize("arguments", [["/nope"], ["/nope", "-q"], [], ["/talker", "--shel", "bash"], ["/a b"]])
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_eval_fails_if_there_are_no_variables(
    keymint, ws: Path, tmp_path: Path, shell: str, arguments: list[str]
) -> None:
    """Otherwise a node that starts after it has no security."""
    outcome = keymint("env", *arguments, "-w", ws)
    assert outcome.code != 0
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    (tmp_path / "lines").write_text(outcome.out)
    show = "cat lines | source; and echo started" if shell == "fish" else 'eval "$(cat lines)" && echo started'
    done = subprocess.run([shell, "-c", show], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == ""
    assert done.returncode != 0


def test_each_syntax(keymint, ws: Path) -> None:
    lines = keymint("env", "talker", "-w", "ws").out
    assert lines == keymint("env", "talker", "--shell", "zsh", "-w", "ws").out
    assert lines.splitlines() == [
        f"export ROS_SECURITY_KEYSTORE={ws}/install",
        "export ROS_SECURITY_ENABLE=true",
        "export ROS_SECURITY_STRATEGY=Enforce",
        "export ROS_SECURITY_ENCLAVE_OVERRIDE=/talker",
    ]
    fish = keymint("env", "/talker", "--shell", "fish", "-w", "ws").out
    assert fish.splitlines()[-1] == "set -gx ROS_SECURITY_ENCLAVE_OVERRIDE /talker"


def test_json(keymint, ws: Path) -> None:
    result = keymint("env", "/talker", "-w", "ws", "--json").document["result"]
    assert result["enclave"] == "/talker"
    assert result["variables"]["ROS_SECURITY_KEYSTORE"] == f"{ws}/install"


def test_an_unknown_enclave(keymint, ws: Path) -> None:
    outcome = keymint("env", "/tolker", "-w", "ws")
    assert (outcome.code, outcome.out) == (1, "false\n")
    assert (
        outcome.err
        == "ws/install/enclaves: error: there is no enclave /tolker (did you mean '/talker'?) [enclave-unknown]\n"
    )
    assert keymint("env", "/x;reboot", "-w", "ws", "--json").codes() == ["name-illegal"]


def test_a_run_that_is_stopped_sets_nothing_either(capsys: pytest.CaptureFixture, monkeypatch) -> None:
    def stop(_: object) -> int:
        raise StoppedError(signal.SIGTERM)

    monkeypatch.setattr(cli, "_carried_out", stop)
    assert cli.main(["env", "/talker", "-w", "ws"]) == 128 + signal.SIGTERM
    assert capsys.readouterr().out == "false\n"
    assert cli.main(["check", "-w", "ws"]) == 128 + signal.SIGTERM
    assert capsys.readouterr().out == ""


def test_one_that_is_not_installed(keymint, ws: Path) -> None:
    shutil.rmtree(ws / "install/enclaves/talker")
    outcome = keymint("env", "/talker", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["not-installed"])
    assert outcome.document["diagnostics"][0]["help"] == "run 'keymint install talker -w ws'"


def test_one_that_was_revoked(keymint, ws: Path) -> None:
    """'keymint install' gives it nothing."""
    assert keymint("revoke", "talker", "--reason", "key-compromise", "-w", "ws").code == 0
    outcome = keymint("env", "/talker", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["not-installed"])
    assert "'keymint renew --rekey talker -w ws'" in outcome.document["diagnostics"][0]["help"]
    assert keymint("renew", "--rekey", "talker", "-w", "ws").code == 0
    assert keymint("env", "/talker", "-w", "ws").code == 0


def test_it_writes_nothing(keymint, ws: Path) -> None:
    before = snapshot(ws)
    assert keymint("env", "/talker", "-w", "ws").code == 0
    assert snapshot(ws) == before


def test_both_transports(keymint, policy: Path, tmp_path: Path) -> None:
    keymint("provision", policy, "-w", "both", "--transport", "dds", "--transport", "zenoh")
    install = tmp_path / "both/install"
    values = keymint("env", "/talker", "-w", "both", "--json").document["result"]["variables"]
    assert values["ZENOH_SESSION_CONFIG_URI"] == f"{install}/enclaves/talker/session.json5"
    assert values["ROS_SECURITY_ENCLAVE_OVERRIDE"] == "/talker"
    router = keymint("env", "zenoh_router", "-w", "both", "--json").document["result"]["variables"]
    assert router == {"ZENOH_ROUTER_CONFIG_URI": f"{install}/zenoh/router.json5"}


def test_without_a_domain_a_node_starts_in_0(keymint, ws: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert keymint("env", "/talker", "-w", "ws").err == ""
    assert keymint("set", "domain", "5", "-w", "ws").code == 0
    warned = keymint("env", "/talker", "-w", "ws")
    assert (
        warned.code,
        "ROS_DOMAIN_ID is not set, which means 0, but the workspace is for domain 5" in warned.err,
    ) == (
        0,
        True,
    )
    assert keymint("env", "/talker", "-w", "ws", env={"ROS_DOMAIN_ID": "5"}).err == ""
