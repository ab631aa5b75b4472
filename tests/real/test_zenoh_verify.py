# SPDX-License-Identifier: Apache-2.0
"""``keymint verify`` on real Zenoh with installed workspaces: the same policies as on DDS, and edits by hand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.conftest import CHECKOUT
from tests.effort import FULL

pytestmark = [pytest.mark.zenoh, pytest.mark.usefixtures("zenoh_library")]

EXAMPLES = ("talker_listener", "add_two_ints", "action", "ppac_2018/policy.xml")
BOTH = ("--transport", "dds", "--transport", "zenoh")


@pytest.fixture(autouse=True)
def real_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the clock of the machine, as real vendors do."""
    monkeypatch.delenv("SOURCE_DATE_EPOCH")


def verified(keymint, *arguments: str) -> dict[str, dict]:
    """Verify the workspace and return what each transport found, by its name."""
    outcome = keymint("verify", "-w", "ws", *arguments, "--json")
    assert outcome.code in {0, 3}, outcome.out
    return {each["name"]: each for each in outcome.document["result"]["transports"]}


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_have_no_mismatches(keymint, example: str) -> None:
    assert keymint("provision", CHECKOUT / "examples" / example, "-w", "ws", "--transport", "zenoh").code == 0
    found = verified(keymint, "-i", "zenoh-1", "-i", "zenoh")
    for transport in found.values():
        counts = transport["confusion"]
        assert counts["false_positive"] == counts["false_negative"] == 0
        assert counts["true_positive"] > 15
    assert found["zenoh"]["confusion"] == found["zenoh-1"]["confusion"]


def test_data_is_exchanged_as_the_policy_says(keymint) -> None:
    policy = CHECKOUT / "examples/add_two_ints"
    assert keymint("provision", policy, "-w", "ws", "--transport", "zenoh").code == 0
    counts = verified(keymint, "-i", "zenoh", "--tier", "exchange")["zenoh"]["confusion"]
    assert counts["false_positive"] == counts["false_negative"] == 0
    assert counts["true_positive"] > 15


@pytest.mark.cyclonedds
@pytest.mark.fastdds
def test_one_workspace_for_dds_and_zenoh_is_as_its_policy_on_all_of_them(
    keymint, cyclone_plugins: None, fastdds: object
) -> None:
    """The certificates of nodes are for clients only."""
    example, rights = ("fleet", 200) if FULL else ("action", 30)
    assert keymint("provision", CHECKOUT / "examples" / example, "-w", "ws", *BOTH).code == 0
    found = verified(keymint, "-i", "zenoh-1", "-i", "zenoh", "-i", "cyclonedds", "-i", "fastdds")
    assert set(found) == {"zenoh-1", "zenoh", "cyclonedds", "fastdds"}
    for transport in found.values():
        counts = transport["confusion"]
        assert counts["false_positive"] == counts["false_negative"] == 0
        assert counts["true_positive"] > rights
    assert found["zenoh"]["confusion"] == found["zenoh-1"]["confusion"]


@pytest.mark.parametrize("transport", ["zenoh-1", "zenoh"])
def test_an_edit_of_the_routers_file_is_reported_with_its_place(keymint, tmp_path: Path, transport: str) -> None:
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws", "--transport", "zenoh").code == 0
    router = tmp_path / "ws/install/zenoh/router.json5"
    wider = re.sub(r'"0/chatter/', '"0/chatter$*/', router.read_text())
    assert wider != router.read_text()
    router.write_text(wider)
    finding = next(
        each for each in verified(keymint, "-i", transport)[transport]["findings"]
        if each["request"] == "/talker ros_publish /chatterx"
    )  # fmt: skip
    assert finding["error"] == "false-positive"
    assert finding["transport"]["rule"]["file"].endswith("zenoh/router.json5")
    assert finding["transport"]["rule"]["line"] > 0


def test_a_certificate_in_the_place_of_another_is_reported(keymint, tmp_path: Path) -> None:
    assert keymint("provision", CHECKOUT / "examples/talker_listener", "-w", "ws", "--transport", "zenoh").code == 0
    enclaves = tmp_path / "ws/install/enclaves"
    for name in ("cert.pem", "key.pem"):
        (enclaves / "talker" / name).write_bytes((enclaves / "listener" / name).read_bytes())
    findings = verified(keymint, "-i", "zenoh")["zenoh"]["findings"]
    wrong = {(each["request"], each["error"]) for each in findings}
    assert ("/talker ros_publish /chatter", "false-negative") in wrong
    assert ("/talker ros_subscribe /chatter", "false-positive") in wrong
