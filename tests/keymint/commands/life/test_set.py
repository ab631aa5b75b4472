# SPDX-License-Identifier: Apache-2.0
"""``keymint set``: a setting changes in place, and the output lists what is to be signed again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import snapshot

GRANTS, GOVERNANCE = "profile/package.defaults/permissions.xml", "profile/package.defaults/governance.xml"
ALL = ["/robot1/listener", "/talker"]


def values(keymint: Callable, ws: Path) -> dict[str, str]:
    rows = keymint("set", "--json", cwd=ws).document["result"]["settings"]
    return {each["setting"]: each["value"] for each in rows}


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("setting", "given", "value", "again"),
    [
        ("domain", "5", "5", ALL), ("valid-for", "90d", "P90D", ALL), ("subject-format", "sros2", "sros2", ALL),
        ("distro", "humble", "humble", ALL), ("distro", "kilted", "kilted", []),
    ],
)  # fmt: skip
def test_a_setting_changes_and_what_follows_is_said(
    keymint: Callable, provisioned: Path, setting: str, given: str, value: str, again: list[str]
) -> None:
    before = snapshot(provisioned)
    shown = keymint("set", setting, given, "--dry-run", "--json", cwd=provisioned)
    assert shown.document["result"]["signed_again"] == again
    assert snapshot(provisioned) == before
    made = keymint("set", setting, given, "--json", cwd=provisioned)
    assert (made.code, made.document["result"]["signed_again"]) == (0, again)
    assert values(keymint, provisioned)[setting] == value
    provision = keymint("provision", "../policy.xml", "-w", ".", "--json", cwd=provisioned)
    assert provision.code == 0
    steps = provision.document["steps"]
    signed = [f"/{each['package']}" for each in steps if each["stage"] == "install" and each["action"] == "updated"]
    assert [each for each in signed if each in ALL] == again
    assert keymint("check", cwd=provisioned).code == 0
    unchanged = keymint("set", setting, value, "--json", cwd=provisioned)
    assert [each["action"] for each in unchanged.document["steps"]] == ["unchanged"]


def test_comments_and_layout_stay(keymint: Callable, provisioned: Path) -> None:
    grants = provisioned / GRANTS
    edit(grants, "    <id>0</id>\n", "    <!-- <id>9</id> -->\n\t<id>\n0</id>  <!-- lab -->\n")
    text = grants.read_text()
    assert keymint("set", "domain", "230", cwd=provisioned).code == 0
    assert grants.read_text() == text.replace("<id>\n0<", "<id>\n230<")
    assert "<id>230</id>" in (provisioned / GOVERNANCE).read_text()


def test_the_library_follows_the_distribution_unless_edited(keymint: Callable, provisioned: Path) -> None:
    common = provisioned / "profile/comarmor.d/common"
    edit(common / "tf.xml", "<profiles", "<!-- ours -->\n<profiles") if "<profiles" in (
        common / "tf.xml"
    ).read_text() else (common / "tf.xml").write_text("<!-- ours -->\n" + (common / "tf.xml").read_text())
    ours, node = (common / "tf.xml").read_text(), (common / "node.xml").read_text()
    assert keymint("set", "distro", "humble", cwd=provisioned).code == 0
    assert (common / "tf.xml").read_text() == ours
    assert "type_description" in node
    assert "type_description" not in (common / "node.xml").read_text()


@pytest.mark.parametrize(
    ("words", "code", "hint"),
    [
        (("domian", "5"), "setting-unknown", "'domain'"), (("transport", "zenoh"), "setting-unknown", "keymint init"),
        (("domain", "231"), "domain-range", "ROS_DOMAIN_ID"), (("domain", "x"), "domain-range", "ROS_DOMAIN_ID"),
        (("domain", "\u0663"), "domain-range", ""), (("distro", "humbel"), "distro-unknown", "'humble'"),
        (("valid-for", "soon"), "usage", ""), (("subject-format", "sros"), "subject-format-unknown", ""),
        (("layout", "flat"), "setting-unknown", "keymint init"),
    ],
)  # fmt: skip
def test_a_wrong_setting_or_value_changes_nothing(
    keymint: Callable, provisioned: Path, words: tuple[str, ...], code: str, hint: str
) -> None:
    before = snapshot(provisioned)
    refused = keymint("set", *words, "--json", cwd=provisioned)
    assert (refused.codes(), hint in refused.document["diagnostics"][0]["help"]) == ([code], True)
    assert refused.code in {1, 2}
    assert snapshot(provisioned) == before


@pytest.mark.parametrize("how", ["two domains", "UTF-16"])
def test_what_is_written_in_another_way_is_left_to_its_owner(keymint: Callable, provisioned: Path, how: str) -> None:
    for file in (GRANTS, GOVERNANCE):
        text = (provisioned / file).read_text()
        if how == "UTF-16":
            (provisioned / file).write_bytes(text.replace("UTF-8", "UTF-16").encode("utf-16"))
        else:
            (provisioned / file).write_text(text.replace("<domains>", "<domains ><id>3</id>"))
    before = snapshot(provisioned)
    refused = keymint("set", "domain", "5", "--json", cwd=provisioned)
    assert refused.code == 1
    assert refused.document["diagnostics"][0]["file"] == GRANTS
    assert snapshot(provisioned) == before


def test_the_message_about_an_option_leads_here(keymint: Callable, provisioned: Path) -> None:
    refused = keymint("provision", "../policy.xml", "-w", ".", "--domain", "5", cwd=provisioned)
    assert refused.code == 1
    assert "'keymint set domain 5'" in refused.err
    assert keymint("set", "domain", "5", cwd=provisioned).code == 0
    assert keymint("provision", "../policy.xml", "-w", ".", "--domain", "5", cwd=provisioned).code == 0


def test_of_the_router(keymint: Callable, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "ws", "--transport", "zenoh").code == 0
    router = tmp_path / "ws/install/zenoh/router.json5"
    before = router.read_bytes()
    assert "/talker" in keymint("set", "domain", "5", "-w", "ws").out
    assert keymint("provision", policy, "-w", "ws").code == 0
    assert router.read_bytes() != before
    assert keymint("check", "-w", "ws").code == 0


@pytest.mark.parametrize("asked", ["5", "abc", "00000000005"])
def test_another_domain_in_the_environment_is_a_warning(keymint: Callable, provisioned: Path, asked: str) -> None:
    provision = ("provision", "../policy.xml", "-w", ".")
    for words in (provision, provision, ("check",), ("env", "talker")):
        warned = keymint(*words, "--json", cwd=provisioned, env={"ROS_DOMAIN_ID": asked})
        assert (warned.code, warned.codes()) == (0, ["domain-environment"]), words
        assert "'keymint set domain" in warned.document["diagnostics"][0]["help"]
        for same in ("0", "", "000"):
            assert keymint(*words, "--json", cwd=provisioned, env={"ROS_DOMAIN_ID": same}).codes() == []
    edit(provisioned / GRANTS, "<id>0</id>", "<id>0</id><id_range><min>4</min><max>6</max></id_range>")
    assert keymint("env", "talker", "--json", cwd=provisioned, env={"ROS_DOMAIN_ID": "4"}).codes() == []


@pytest.mark.parametrize(("setting", "value"), [("domain", "5"), ("distro", "humble"), ("valid-for", "90d")])
def test_the_advice_leads_through(keymint: Callable, tmp_path: Path, setting: str, value: str) -> None:
    """So many subjects lose a right with a domain or a distribution that one is asked."""
    robots = "".join(f"<attachment>/r{number}</attachment>" for number in range(6))
    node = '<xi:include href="common/node.xml" parse="xml"/>'
    xinclude = 'xmlns:xi="http://www.w3.org/2001/XInclude"'
    (tmp_path / "fleet.xml").write_text(f'<profiles {xinclude}><profile name="r">{robots}{node}</profile></profiles>')
    assert keymint("provision", "fleet.xml", "-w", "ws").code == 0
    said = keymint("set", setting, value, "-w", "ws").out
    agreed = "" if setting == "valid-for" else " --yes"
    assert f"run 'keymint provision fleet.xml -w ws{agreed}'" in said
    if setting == "distro":  # not so far as to sign what the policy does not say
        assert keymint("build", "-w", "ws").code == 0
        refused = keymint("install", "-w", "ws")
        assert "counterexample" in refused.err
        assert (
            "'keymint create --all -w ws' and 'keymint build -w ws' first" in refused.err,
            "no-prove" in refused.err,
        ) == (
            True,
            False,
        )
    words = said.split("run 'keymint ")[1].split("'")[0].split()
    assert keymint(*words).code == 0
    assert keymint("check", "-w", "ws").code == 0
