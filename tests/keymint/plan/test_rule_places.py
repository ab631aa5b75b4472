# SPDX-License-Identifier: Apache-2.0
"""Messages about rules name their lines in the policy as it is now, whatever the sources of a package state."""

from __future__ import annotations

from pathlib import Path

import pytest

BAD = "<attachment>/no-name</attachment>"


def _line(text: str, about: str) -> int:
    (line,) = (line for line in text.splitlines() if about in line)
    return int(line.split(":")[1])


@pytest.mark.parametrize("transport", ["dds", "zenoh"])
def test_a_warning_follows_a_rule_whose_lines_moved(keymint, policy: Path, tmp_path: Path, transport: str) -> None:
    policy.write_text(policy.read_text().replace("<attachment>/chatter</attachment>", BAD, 1))
    assert keymint("provision", policy, "-w", "ws", "--transport", transport).code == 0
    ws = tmp_path / "ws"
    before = _line(keymint("build", "-f", cwd=ws).err, "/no-name")
    policy.write_text(policy.read_text().replace("<profiles", "\n\n<profiles", 1))
    assert _line(keymint("build", "-f", cwd=ws).err, "/no-name") == before + 2


def test_sources_with_other_rules_are_cited_as_they_state_it(keymint, created: Path, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("<attachment>/chatter</attachment>", BAD, 1))
    assert keymint("create", "--all", cwd=created).code == 0
    before = _line(keymint("build", cwd=created).err, "/no-name")
    policy.write_text(
        policy.read_text()
        .replace("<profiles", "\n\n<profiles", 1)
        .replace(BAD, BAD.replace("/no-name", "/more") + BAD, 1)
    )
    assert _line(keymint("build", "-f", cwd=created).err, "/no-name") == before
    policy.unlink()
    assert _line(keymint("build", "-f", cwd=created).err, "/no-name") == before
