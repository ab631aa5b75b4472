# SPDX-License-Identifier: Apache-2.0
"""``keymint verify`` on real vendors: the examples have no mismatches, and an edit by hand is reported."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from keymint.pki import keys
from tests.conftest import CHECKOUT
from tests.opened_governance import open_governance

from .conftest import REAL_TRANSPORTS, TRANSPORTS, usable_transport, variation

EXAMPLES = ("talker_listener", "add_two_ints", "action", "fleet")


@pytest.fixture(params=REAL_TRANSPORTS)
def transport(request: pytest.FixtureRequest) -> str:
    """The name of a real transport, where it is installed."""
    usable_transport(request.param)
    return request.param


@pytest.fixture(autouse=True)
def real_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the clock of the machine, as real vendors do."""
    monkeypatch.delenv("SOURCE_DATE_EPOCH")


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_have_no_mismatches(keymint, tmp_path: Path, example: str, transport: str) -> None:
    assert keymint("provision", CHECKOUT / "examples" / example, "-w", "ws").code == 0
    outcome = keymint("verify", "-w", "ws", "-i", transport, "--json")
    assert outcome.code == 0, outcome.out
    (found,) = outcome.document["result"]["transports"]
    counts = found["confusion"]
    assert counts["false_positive"] == counts["false_negative"] == 0
    assert counts["true_positive"] > 20


def test_an_edit_by_hand_is_reported_and_explained_by_the_model(keymint, tmp_path: Path, transport: str) -> None:
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws").code == 0
    path = tmp_path / "ws/build/talker/permissions.xml"
    path.write_text(path.read_text().replace("<topic>rt/chatter<", "<topic>rt/chatter*<"))
    assert keymint("install", "--no-prove", "-w", "ws").code == 0
    outcome = keymint("verify", "-w", "ws", "-i", transport, "--json")
    assert outcome.code == 3
    (found,) = outcome.document["result"]["transports"]
    first = next(each for each in found["findings"] if each["request"] == "/talker ros_publish /chatterx")
    assert first["error"] == "false-positive"
    assert first["transport"]["explained_by"] == variation(TRANSPORTS[transport][1]).name
    assert first["transport"]["said"]
    assert first["transport"]["rule"]["line"] > 0


def test_names_that_only_the_governance_mentions_are_asked(keymint, tmp_path: Path, transport: str) -> None:
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws").code == 0
    open_governance(tmp_path / "ws", "talker", "rt/zz*")
    outcome = keymint("verify", "-w", "ws", "-i", transport, "--json")
    assert outcome.code == 3
    (found,) = outcome.document["result"]["transports"]
    requests = {each["request"] for each in found["findings"] if each["error"] == "false-positive"}
    assert any("zzx" in each for each in requests), requests


def test_an_expired_grant_makes_vendors_refuse_the_enclave(keymint, tmp_path: Path, transport: str) -> None:
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws").code == 0
    path = tmp_path / "ws/build/talker/permissions.xml"
    text = re.sub("<not_before>[^<]*", "<not_before>2020-01-01T00:00:00", path.read_text())
    path.write_text(re.sub("<not_after>[^<]*", "<not_after>2020-02-01T00:00:00", text))
    assert keymint("install", "--no-prove", "-w", "ws").code == 0
    outcome = keymint("verify", "-w", "ws", "-i", transport, "--json")
    assert outcome.code == 3
    (found,) = outcome.document["result"]["transports"]
    assert {each["edge"]["subject"] for each in found["findings"]} == {"/talker"}
    assert found["confusion"]["false_positive"] == 0
    assert all("expired" in each["transport"]["reason"] for each in found["findings"])


def test_revocation_lists_are_read_as_nodes_read_them(keymint, tmp_path: Path, transport: str) -> None:
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws").code == 0
    assert keymint("revoke", "talker", "--reason", "superseded", "-w", "ws").code == 0
    assert keymint("verify", "-w", "ws", "-i", transport).code == 0
    (tmp_path / "ws/install/enclaves/talker/crl.pem").write_bytes(b"")
    model = variation(TRANSPORTS[transport][1]).name
    answers = []
    for asked in (("-i", transport, "--tier", "admission"), ("-i", transport), ("-i", model)):
        outcome = keymint("verify", "-w", "ws", *asked, "--json")
        assert outcome.code == 3
        (found,) = outcome.document["result"]["transports"]
        assert {each["edge"]["subject"] for each in found["findings"]} == {"/talker"}
        answers.append((found["confusion"], [each["edge"] for each in found["findings"]]))
    assert answers[0] == answers[1] == answers[2]
    assert "crl.pem is not a revocation list" in outcome.out


def test_participants_without_the_password_are_not_verified(keymint, tmp_path: Path, fastdds: object) -> None:
    """Fast DDS refuses the participant, which is not a decision about the enclave."""
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws").code == 0
    path = tmp_path / "ws/install/enclaves/listener/key.pem"
    path.write_bytes(keys.to_pem(keys.from_pem(path.read_bytes()), b"secret word"))
    outcome = keymint("verify", "-w", "ws", "-i", "fastdds")
    assert outcome.code == 1
    assert "error: the private key of /listener is encrypted" in outcome.err
    assert keymint("verify", "-w", "ws", "-i", "fastdds-2.9").code == 0
