# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: every kind of damage is a finding with a stable code."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import pytest
from keymint_ros import permissions
from keymint_ros2_dds import DdsSecurity

from keymint.examine import check
from keymint.host.pool import Pool, divide
from tests.conftest import NOW, snapshot

DAY = 86_400


def enclave(ws: Path) -> Path:
    return ws / "install/enclaves/talker"


def test_clean(keymint, provisioned: Path) -> None:
    assert keymint("check", cwd=provisioned).code == 0  # which records what it proves
    before = snapshot(provisioned)
    outcome = keymint("check", cwd=provisioned)
    assert outcome.code == 0
    assert outcome.out == "checked 2 enclaves: no findings\n"
    assert outcome.err == ""
    assert snapshot(provisioned) == before


def test_nobody_is_told_to_show_a_private_key_to_others(keymint, provisioned: Path) -> None:
    """Of files that Keymint did not write, a key is one by its content, and what its owner hides may be one."""
    pem = (provisioned / "private/permissions_ca.key.pem").read_bytes()
    for name, content, mode in (
        ("a.pem", pem, 0o600),
        ("b.pem", pem, 0o644),
        ("c.bin", b"\0", 0o600),
        ("d", b"", 0o666),
    ):
        (enclave(provisioned) / name).write_bytes(content)
        (enclave(provisioned) / name).chmod(mode)
    outcome = keymint("check", "--json", cwd=provisioned)
    found = {
        each["file"].rpartition("/")[2]: (each["severity"], each["help"].split()[:2])
        for each in outcome.document["diagnostics"]
        if each["code"] == "file-mode"
    }
    assert found == {"b.pem": ("error", ["chmod", "600"]), "d": ("error", ["chmod", "644"])}


def test_sarif(keymint, provisioned: Path) -> None:
    (enclave(provisioned) / "key.pem").chmod(0o644)
    (enclave(provisioned) / "permissions.p7s").unlink()
    outcome = keymint("check", "--json", "--sarif", "../check.sarif", cwd=provisioned)
    assert outcome.code == 3
    (log,) = json.loads((provisioned.parent / "check.sarif").read_text())["runs"]
    assert log["tool"]["driver"]["name"] == "keymint check"
    rules = [each["id"] for each in log["tool"]["driver"]["rules"]]
    found = [
        (rules[each["ruleIndex"]], each["level"], each["locations"][0]["physicalLocation"]["artifactLocation"]["uri"])
        for each in log["results"]
    ]
    listed = [(each["code"], each["severity"], each["file"]) for each in outcome.document["diagnostics"]]
    assert [each[0] for each in found] == ["file-mode", "file-missing", "document-differs"]
    assert found == listed
    before = snapshot(provisioned)
    assert keymint("check", "--sarif", "../refused.sarif", "nobody", cwd=provisioned).code == 1
    assert '"package-unknown"' in (provisioned.parent / "refused.sarif").read_text()
    assert snapshot(provisioned) == before


def remove(name: str) -> Callable[[Path], None]:
    return lambda ws: (enclave(ws) / name).unlink()


def mode(name: str, value: int) -> Callable[[Path], None]:
    return lambda ws: (ws / name).chmod(value)


def swap_key(ws: Path) -> None:
    shutil.copyfile(ws / "install/enclaves/robot1/listener/key.pem", enclave(ws) / "key.pem")


def swap_enclave(name: str) -> Callable[[Path], None]:
    """A whole signed file of another enclave: sound in itself, but not this subject's."""
    return lambda ws: shutil.copyfile(ws / "install/enclaves/robot1/listener" / name, enclave(ws) / name)


def plant_ca_key(ws: Path) -> None:
    shutil.copyfile(ws / "private/permissions_ca.key.pem", ws / "install/public/permissions_ca.key.pem")


def link(ws: Path) -> None:
    path = enclave(ws) / "identity_ca.cert.pem"
    path.unlink()
    path.symlink_to("../../public/identity_ca.cert.pem")


def edit_source(ws: Path) -> None:
    path = ws / "src/talker/permissions.xml"
    path.write_text(path.read_text().replace("/chatter", "/other"))


def widen_governance(ws: Path) -> None:
    path = ws / "profile/package.defaults/permissions.xml"
    path.write_text(path.read_text().replace("<id>0</id>", "<id>0</id><id>5</id>"))


def uninstall(ws: Path) -> None:
    shutil.rmtree(enclave(ws))


@pytest.mark.parametrize(
    "damage",
    [
        *[
            remove(name)
            for name in ("cert.pem", "key.pem", "governance.p7s", "permissions.p7s", "permissions_ca.cert.pem")
        ],
        mode("install/enclaves/talker/key.pem", 0o644),
        mode("install/enclaves/talker", 0o755),
        mode("private/identity_ca.key.pem", 0o640),
        mode("private", 0o755),
        swap_key,
        *[swap_enclave(name) for name in ("cert.pem", "permissions.p7s", "permissions.xml")],
        plant_ca_key,
        link,
        edit_source,
        widen_governance,
        uninstall,
    ],
)
def test_damage_is_found(keymint, provisioned: Path, damage: Callable[[Path], None]) -> None:
    damage(provisioned)
    outcome = keymint("check", "--json", cwd=provisioned)
    assert outcome.code == 3
    for finding in outcome.document["diagnostics"]:
        assert finding["code"]
        assert "\n" not in finding["message"] + finding["help"]


def widen_policy(ws: Path) -> None:
    policy = ws.parent / "policy.xml"
    policy.write_text(policy.read_text().replace("chatter", "other"))


def break_policy(ws: Path) -> None:
    (ws.parent / "policy.xml").write_text("<policies>")


def edit_build(ws: Path) -> None:
    path = ws / "build/talker/permissions.xml"
    path.write_text(path.read_text().replace("rt/", "rq/"))


CHANGES = [
    uninstall,
    edit_source,
    edit_build,
    widen_governance,
    swap_key,
    swap_enclave("permissions.p7s"),
    widen_policy,
    break_policy,
]


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_recorded_is_as_if_it_were_built(keymint, provisioned: Path, change: Callable[[Path], None]) -> None:
    change(provisioned)
    outcome = keymint("check", "--json", cwd=provisioned)
    with mock.patch.object(check, "is_build_current", return_value=False) as recorded:
        built = keymint("check", "--json", cwd=provisioned)
    assert recorded.called
    assert (outcome.code, outcome.out, outcome.err) == (built.code, built.out, built.err)


def test_sources_that_were_built_are_neither_parsed_nor_built_again(keymint, just_provisioned: Path) -> None:
    with (
        mock.patch.object(permissions, "read", side_effect=AssertionError),
        mock.patch.object(DdsSecurity, "build", side_effect=AssertionError),
    ):
        assert keymint("check", cwd=just_provisioned).code == 0


@pytest.mark.parametrize("change", [*CHANGES, lambda ws: (ws / "src/talker/keymint_package.xml").write_text("<")])
def test_several_processes_find_the_same(
    keymint, provisioned: Path, monkeypatch: pytest.MonkeyPatch, change: Callable[[Path], None]
) -> None:
    monkeypatch.setattr(Pool, "parts", lambda self, items, _least: divide(items, self.size))
    change(provisioned)
    alone, together = (keymint("check", "--json", "-j", number, cwd=provisioned) for number in ("1", "2"))
    assert (alone.code, alone.out, alone.err) == (together.code, together.out, together.err)


@pytest.mark.parametrize(
    ("later", "within", "code"),
    [(0, "0d", 0), (0, "30d", 0), (0, "400d", 3), (350, "30d", 3), (400, "0d", 3), (5000, "0d", 3), (-10, "0d", 3)],
)
def test_validity(keymint, provisioned: Path, later: int, within: str, code: int) -> None:
    outcome = keymint("check", "--within", within, cwd=provisioned, env={"SOURCE_DATE_EPOCH": str(NOW + later * DAY)})
    assert outcome.code == code, outcome.err


@pytest.mark.parametrize("text", ["soon", "30", "-1d", "1m", "999999w"])
def test_a_period_that_is_none(keymint, provisioned: Path, text: str) -> None:
    outcome = keymint("check", "--within", text, cwd=provisioned)
    assert outcome.code == 2
