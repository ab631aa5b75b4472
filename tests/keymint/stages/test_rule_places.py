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


def test_a_file_that_is_included_twice_is_cited_with_its_own_include(keymint, policy: Path, tmp_path: Path) -> None:
    include = '<xi:include href="part.xml" parse="xml"/>'
    profile = f"<profile name='{{}}'{{}}><attachment>/talker</attachment>\n{include}\n</profile>\n"
    audit = " modifier='AUDIT'"
    namespace = "xmlns:xi='http://www.w3.org/2001/XInclude'"
    text = f"<profiles {namespace}>\n{profile.format('a', '')}{profile.format('b', audit)}</profiles>"
    rule = f"<ros_topic qualifier='ALLOW'>{BAD}<permissions><ros_publish/></permissions></ros_topic>"
    (tmp_path / "part.xml").write_text(rule)
    policy.write_text(text)
    assert keymint("provision", policy, "-w", "ws").code == 0
    before = keymint("build", "-f", cwd=tmp_path / "ws").err
    assert "policy.xml:3" in before
    assert "policy.xml:6" in before
    policy.write_text(text.replace("<profiles", "\n\n<profiles", 1))
    found = keymint("build", "-f", cwd=tmp_path / "ws").err
    assert found == before.replace("policy.xml:3", "policy.xml:5").replace("policy.xml:6", "policy.xml:8")


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


def test_lines_that_moved_are_no_edit_by_hand(keymint, policy: Path, created: Path) -> None:
    """A checkout that moved has other places as well, and is not edited either."""
    policy.write_text(policy.read_text().replace("<profiles", "\n\n<profiles", 1))
    assert keymint("create", "talker", "--valid-for", "30d", cwd=created).code == 0
    assert "<duration>P30D</duration>" in (created / "src/talker/permissions.xml").read_text()
    edited = created / "src/robot1/listener/permissions.xml"
    edited.write_text(edited.read_text().replace("</grant>", "<!-- mine --></grant>"))
    assert "[hand-edited]" in keymint("create", "robot1/listener", "--valid-for", "30d", cwd=created).err
