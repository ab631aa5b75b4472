# SPDX-License-Identifier: Apache-2.0
"""What ROS packages ship grants nothing before the owner of a workspace accepted it, and nothing else afterwards."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from keymint.api.graph import Edge, Graph, Object
from keymint.api.graph_json import dump
from keymint.client import Client
from keymint.errors import KeymintError
from tests.conftest import CHECKOUT, Outcome, snapshot
from tests.keymint.commands.test_json import held
from tests.keymint.commands.test_unchanged import settle
from tests.ros_packages import HREF, PACKAGE, fragment, including, ship, topic

ACCEPT = ("--trust-package", PACKAGE)


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a package in a prefix, which ``policy.xml`` includes."""
    folder = ship(tmp_path / "prefix", {"controller.xml": fragment(topic("/cmd_vel"))})
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    (tmp_path / "policy.xml").write_text(including(HREF))
    return folder / "controller.xml"


@pytest.fixture
def ws(keymint: Callable[..., Outcome], shipped: Path, tmp_path: Path) -> Path:
    """A workspace of that policy without packages, in which nothing is accepted yet."""
    assert keymint("init", "ws", "--policy", "policy.xml").code == 0
    return tmp_path / "ws"


@pytest.fixture
def accepted(keymint: Callable[..., Outcome], ws: Path) -> Path:
    outcome = keymint("create", "--all", "-w", "ws", *ACCEPT)
    assert outcome.code == 0, outcome.err
    return ws


def rules(workspace: Path) -> str:
    return (workspace / "src/robot/controller/permissions.xml").read_text()


def test_the_first_use_needs_acceptance_and_shows_what_it_grants(keymint, ws: Path) -> None:
    before = snapshot(ws)
    outcome = keymint("create", "--all", "-w", "ws")
    assert outcome.code == 1
    assert outcome.out.splitlines() == [
        "/robot/controller:",
        f"  + ros_publish /cmd_vel ({HREF}:3)",
        "1 subject gains, none lose",
    ]
    assert outcome.err.startswith(
        f"policy.xml:2: error: what the package '{PACKAGE}' ships was not accepted yet: contr"
    )
    assert f"repeat the command with --trust-package {PACKAGE}=" in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert snapshot(ws) == before


def test_a_new_workspace_is_not_begun_with_it(keymint, shipped: Path, tmp_path: Path) -> None:
    assert keymint("provision", "policy.xml", "-w", "ws").code == 1
    assert not (tmp_path / "ws").exists()


def test_what_was_accepted_is_kept_beside_the_policy(keymint, accepted: Path, shipped: Path) -> None:
    lock = (accepted / "profile/packages.lock.xml").read_text()
    assert f'<package name="{PACKAGE}">' in lock
    copy = accepted / f"profile/packages.lock.d/{PACKAGE}/controller.xml"
    assert copy.read_bytes() == shipped.read_bytes()
    assert f'origin="{HREF}:3; ' in rules(accepted)
    again = keymint("create", "--all", "-w", "ws", *ACCEPT)
    assert (again.code, again.out) == (0, "nothing to do: 2 packages up to date\n")


def test_the_same_pin_holds_in_a_copy_of_the_workspace_and_another_prefix(keymint, accepted, shipped, tmp_path) -> None:
    """As for a colleague, and in CI."""
    shutil.copytree(accepted, tmp_path / "theirs", ignore=shutil.ignore_patterns(".keymint"))
    shutil.move(tmp_path / "prefix", tmp_path / "elsewhere")
    env = {"AMENT_PREFIX_PATH": str(tmp_path / "elsewhere")}
    outcome = keymint("create", "--all", "-w", "theirs", env=env)
    assert (outcome.code, outcome.out) == (0, "nothing to do: 2 packages up to date\n")
    ship(tmp_path / "elsewhere", {"controller.xml": fragment(topic("/*"))})
    assert keymint("create", "--all", "-w", "theirs", env=env).code == 1


def test_a_change_is_refused_until_it_is_accepted(keymint, accepted: Path, shipped: Path) -> None:
    shipped.write_text(fragment(topic("/cmd_vel", "ros_subscribe"), topic("/reset")))
    before = snapshot(accepted)
    outcome = keymint("create", "--all", "-w", "ws", "--json")
    assert outcome.code == 1
    document = held(outcome)
    (found,) = document["diagnostics"]
    assert (found["code"], found["file"], found["line"]) == ("package-changed", "policy.xml", 2)
    (file,) = document["result"]["unaccepted"]
    assert (file["package"], file["path"]) == (PACKAGE, "controller.xml")
    assert None not in (file["accepted"], file["shipped"])
    (subject,) = document["result"]["subjects"]
    changes = [(each["change"], each["permission"], each["pattern"]) for each in subject["changes"]]
    assert changes == [
        ("gains", "ros_publish", "/reset"),
        ("gains", "ros_subscribe", "/cmd_vel"),
        ("loses", "ros_publish", "/cmd_vel"),
    ]
    assert snapshot(accepted) == before
    assert keymint("create", "-w", "ws", *ACCEPT, "--dry-run").code == 0
    assert snapshot(accepted) == before
    assert keymint("create", "-w", "ws", *ACCEPT).code == 0
    assert "/reset" not in rules(accepted)  # only the acceptance was asked for
    assert keymint("create", "--all", "-w", "ws").code == 0
    assert "/reset" in rules(accepted)


def test_a_change_that_means_the_same_needs_acceptance_too(keymint, accepted: Path, shipped: Path) -> None:
    shipped.write_text(shipped.read_text().replace("<profile", "<!-- a comment -->\n<profile"))
    outcome = keymint("create", "--all", "-w", "ws")
    assert (outcome.code, outcome.out) == (1, "equivalent: no subject gains or loses anything\n")


@pytest.mark.parametrize(
    "verb",
    [["lint"], ["query", "who", "can", "publish", "/x"], ["graph"], ["test"], ["export", "--format", "sros2"]],
)
def test_verbs_that_only_read_refuse_it_as_well(keymint, accepted, shipped, tmp_path, verb) -> None:
    (tmp_path / "policy.test.xml").write_text(
        '<tests><test name="t"><deny subject="/other" permission="publish" object="/cmd_vel"/></test></tests>'
    )
    shipped.write_text(fragment(topic("/reset")))
    outcome = keymint(*verb, cwd=accepted)
    assert outcome.code == 1
    assert "ships something else than what was accepted" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("lint", "policy.xml"), "no findings"),
        (("query", "policy.xml", "who", "can", "publish", "/cmd_vel"), f"({HREF}:3)"),
        (("graph", "policy.xml", "--format", "dot"), "/cmd_vel"),
        (("diff", "policy.xml", "policy.xml"), "equivalent"),
        (("export", "policy.xml", "--format", "sros2"), "cmd_vel"),
        (("learn", "graph.json", "--policy", "policy.xml"), "/other"),
    ],
)
def test_policies_outside_of_a_workspace_read_what_is_installed(keymint, shipped, tmp_path, arguments, words) -> None:
    edges = [Edge("/robot/controller", "ros_publish", Object("ros_topic", name)) for name in ("/cmd_vel", "/other")]
    (tmp_path / "graph.json").write_bytes(dump(Graph.of(edges)))
    outcome = keymint(*arguments)
    assert outcome.code in {0, 3}, outcome.err
    assert words in outcome.out
    if arguments[0] == "learn":
        assert "/cmd_vel" not in outcome.out  # the existing policy has it
    assert keymint(*arguments, env={"AMENT_PREFIX_PATH": ""}).code == 1


def test_a_file_that_an_accepted_one_newly_includes_is_not_accepted(keymint, accepted: Path, shipped: Path) -> None:
    (shipped.parent / "more.xml").write_text(topic("/more"))
    shipped.write_text(fragment(topic("/cmd_vel"), '<xi:include href="more.xml"/>'))
    outcome = keymint("create", "--all", "-w", "ws")
    assert f"  + ros_publish /more (package://{PACKAGE}/more.xml:1)" in outcome.out
    assert "controller.xml, more.xml" in outcome.err
    assert keymint("create", "--all", "-w", "ws", *ACCEPT).code == 0
    copies = accepted / f"profile/packages.lock.d/{PACKAGE}"
    assert sorted(path.name for path in copies.iterdir()) == ["controller.xml", "more.xml"]
    (shipped.parent / "more.xml").write_text(topic("/*"))
    assert keymint("create", "--all", "-w", "ws").code == 1
    shipped.write_text(fragment(topic("/cmd_vel")))
    assert keymint("create", "--all", "-w", "ws", *ACCEPT).code == 0
    assert sorted(path.name for path in copies.iterdir()) == ["controller.xml"]
    assert "more.xml" not in (accepted / "profile/packages.lock.xml").read_text()


def test_one_package_is_accepted_at_a_time(keymint, ws: Path, shipped: Path, tmp_path: Path) -> None:
    ship(tmp_path / "prefix", {"x.xml": topic("/x")}, "second")
    (tmp_path / "policy.xml").write_text(including(HREF, "package://second/x.xml"))
    outcome = keymint("create", "--all", "-w", "ws", *ACCEPT)
    assert outcome.code == 1
    assert "second" in outcome.err
    assert PACKAGE not in outcome.err
    assert not (ws / "profile/packages.lock.xml").exists()  # nothing is half done
    assert keymint("create", "--all", "-w", "ws", *ACCEPT, "--trust-package", "second").code == 0


def test_exactly_what_was_shown_can_be_accepted(keymint, ws: Path, shipped: Path) -> None:
    """Nothing else is accepted if a package changes between the list and the decision."""
    refused = keymint("create", "--all", "-w", "ws")
    (named,) = re.findall(r"--trust-package (\S+=[0-9a-f]{64});", refused.err)
    printed = subprocess.run(["sha256sum", shipped.name], cwd=shipped.parent, capture_output=True, check=True).stdout
    assert named == f"{PACKAGE}={hashlib.sha256(printed).hexdigest()}"
    content = shipped.read_text()
    shipped.write_text(fragment(topic("/*")))
    outcome = keymint("create", "--all", "-w", "ws", "--trust-package", named)
    assert outcome.code == 1
    assert "ships something else than what is to be accepted" in outcome.err
    assert not (ws / "src").exists()
    shipped.write_text(content)
    assert keymint("create", "--all", "-w", "ws", "--trust-package", named).code == 0


@pytest.mark.parametrize("given", [["x=1"], ["x="], ["x=" + "A" * 64], ["x", "x=" + "a" * 64]])
def test_what_is_no_digest(keymint, ws: Path, given: list[str]) -> None:
    options = [word for each in given for word in ("--trust-package", each)]
    assert keymint("create", "--all", "-w", "ws", *options).code == 2


@pytest.mark.parametrize("name", ["nav2_bring_up", "../x", ""])
def test_a_package_that_the_policy_does_not_include(keymint, ws: Path, name: str) -> None:
    outcome = keymint("create", "--all", "-w", "ws", "--trust-package", name)
    assert outcome.code == 2
    assert "the policy includes no file of a package" in outcome.err
    assert len(outcome.err.splitlines()) == 1


def test_an_edited_copy_grants_nothing_and_is_an_error(keymint, accepted: Path) -> None:
    copy = accepted / f"profile/packages.lock.d/{PACKAGE}/controller.xml"
    copy.write_text(fragment(topic("/*")))
    outcome = keymint("lint", cwd=accepted)
    assert outcome.code == 1
    assert f"profile/packages.lock.d/{PACKAGE}/controller.xml: error: is not the copy" in outcome.err
    copy.unlink()
    assert keymint("lint", cwd=accepted).code == 0


def test_a_planted_copy_does_not_hide_what_is_new(keymint, ws: Path, shipped: Path) -> None:
    copy = ws / f"profile/packages.lock.d/{PACKAGE}/controller.xml"
    copy.parent.mkdir(parents=True)
    copy.write_bytes(shipped.read_bytes())
    assert "is not the copy of what was accepted" in keymint("create", "--all", "-w", "ws").err


def test_without_the_copy_all_that_is_new_is_listed(keymint, accepted: Path, shipped: Path) -> None:
    shutil.rmtree(accepted / "profile/packages.lock.d")
    assert keymint("create", "--all", "-w", "ws").code == 0
    shipped.write_text(fragment(topic("/cmd_vel"), topic("/reset")))
    assert "+ ros_publish /cmd_vel " in keymint("create", "--all", "-w", "ws").out


def test_links_are_followed_where_the_owner_decided_it(keymint, ws: Path, shipped: Path, tmp_path: Path) -> None:
    source = tmp_path / "controller_in_src.xml"
    shipped.rename(source)
    shipped.symlink_to(source)
    outcome = keymint("create", "--all", "-w", "ws", *ACCEPT)
    assert outcome.code == 1
    assert "--trust-links" in outcome.err
    assert keymint("create", "--all", "-w", "ws", "--trust-links").code == 2
    assert keymint("create", "--all", "-w", "ws", *ACCEPT, "--trust-links").code == 0
    assert f'<package name="{PACKAGE}" links="follow">' in (ws / "profile/packages.lock.xml").read_text()
    assert keymint("lint", cwd=ws).code == 0
    assert keymint("lint", "policy.xml").code == 1
    assert keymint("lint", "policy.xml", "--trust-links").code == 0
    source.write_text(fragment(topic("/reset")))
    assert keymint("create", "--all", "-w", "ws").code == 1
    assert keymint("create", "--all", "-w", "ws", *ACCEPT).code == 0


def test_an_unchanged_command_reads_what_is_shipped(keymint, accepted: Path, shipped: Path, tmp_path: Path) -> None:
    def verb(name: str) -> Outcome:
        return keymint(name, *(["--all"] if name == "create" else []), "-w", "ws")

    assert verb("build").code == 0
    settle()
    for _ in range(2):
        assert [verb(name).out for name in ("create", "build")] == ["nothing to do: 2 packages up to date\n"] * 2
        settle()
    content = shipped.read_text()
    shipped.write_text(content.replace("/cmd_vel", "/cmd_val"))  # of the same size
    assert verb("create").code == 1
    built = verb("build")
    assert built.code == 0  # what was accepted is built, with a warning that it is no longer shipped
    assert "ships something else than what was accepted" in built.err
    shipped.write_text(content)
    settle()
    assert verb("create").code == 0
    settle()
    assert verb("create").code == 0
    ship(tmp_path / "overlay", {"controller.xml": fragment(topic("/over"))})
    overlaid = f"{tmp_path}/overlay:{tmp_path}/prefix"
    assert keymint("create", "--all", "-w", "ws", env={"AMENT_PREFIX_PATH": overlaid}).code == 1
    assert keymint("create", "--all", "-w", "ws", env={"AMENT_PREFIX_PATH": ""}).code == 1
    assert verb("create").code == 0


def test_a_package_that_appears_in_an_overlay_is_seen(keymint, accepted: Path, tmp_path: Path) -> None:
    env = {"AMENT_PREFIX_PATH": f"{tmp_path}/overlay:{tmp_path}/prefix"}
    for _ in range(3):
        assert keymint("create", "--all", "-w", "ws", env=env).code == 0
        settle()
    ship(tmp_path / "overlay", {"controller.xml": fragment(topic("/over"))})
    outcome = keymint("create", "--all", "-w", "ws", env=env)
    assert outcome.code == 1
    assert "+ ros_publish /over" in outcome.out


def test_provision_and_the_client_take_what_was_accepted(keymint, shipped: Path, tmp_path: Path) -> None:
    assert keymint("provision", "policy.xml", "-w", "ws", *ACCEPT).code == 0
    assert keymint("check", "-w", "ws").code == 0
    assert keymint("provision", "policy.xml", "-w", "ws").out == "nothing to do: 2 packages up to date\n"
    client = Client(tmp_path / "ws")
    assert not client.provision("/robot/controller").changed
    installed = snapshot(tmp_path / "ws/install")
    shipped.write_text(fragment(topic("/*")))
    with pytest.raises(KeymintError, match="ships something else"):
        client.provision("/robot/controller")
    for verb in (("provision", "policy.xml"), ("install",)):
        assert keymint(*verb, "-w", "ws").code == 1
    assert keymint("check", "-w", "ws").code == 3
    status = keymint("status", "-w", "ws")
    assert "ships something else" in status.err
    assert snapshot(tmp_path / "ws/install") == installed


def test_renew_and_revoke_take_what_was_accepted(keymint, shipped: Path, tmp_path: Path) -> None:
    """An update of a package, or a shell without ROS, must not let certificates expire."""
    assert keymint("provision", "policy.xml", "-w", "ws", *ACCEPT).code == 0
    content = shipped.read_text()
    shipped.write_text(fragment(topic("/*")))
    renewed = keymint("renew", "/robot/controller", "--rekey", "-w", "ws")
    assert renewed.code == 0, renewed.err
    assert "warning: the package" in renewed.err
    assert "here it counts as it was accepted" in renewed.err
    document = tmp_path / "ws/build/robot/controller/permissions.xml"
    assert "<topic>rt/cmd_vel</topic>" in document.read_text()
    env = {"AMENT_PREFIX_PATH": ""}
    revoked = keymint("revoke", "/other", "--reason", "superseded", "-w", "ws", env=env)
    assert revoked.code == 0, revoked.err
    assert "is not installed" in revoked.err
    copy = tmp_path / f"ws/profile/packages.lock.d/{PACKAGE}/controller.xml"
    again = ("renew", "/robot/controller", "--rekey", "-w", "ws")
    copy.write_text(shipped.read_text())
    assert "is not the copy" in keymint(*again).err
    copy.unlink()
    refused = keymint(*again)
    assert refused.code == 1
    assert "error: the package" in refused.err
    copy.write_text(content)
    (tmp_path / "policy.xml").write_text(including(HREF, "package://another/x.xml"))
    assert keymint(*again).code == 1


def commit(folder: Path) -> None:
    for command in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "x"]):
        config = ["-c", "user.name=x", "-c", "user.email=x@example.org"]
        subprocess.run(["git", *config, *command], cwd=folder, check=True, env={"PATH": "/usr/bin:/bin"})


def test_diff_reads_a_revision_as_it_was_accepted(keymint, shipped: Path, tmp_path: Path) -> None:
    assert keymint("init", "ws").code == 0
    ws = tmp_path / "ws"
    (ws / "profile/comarmor.d/talker_listener.xml").write_text(including(HREF))
    assert keymint("create", *ACCEPT, cwd=ws).code == 0
    commit(ws)
    shipped.write_text(fragment(topic("/cmd_vel"), topic("/reset")))
    assert keymint("create", *ACCEPT, cwd=ws).code == 0
    outcome = keymint("diff", "HEAD:./", ".", cwd=ws)
    assert outcome.code == 3, outcome.err
    assert f"  + ros_publish /reset ({HREF}:3)" in outcome.out
    shutil.rmtree(ws / "profile/packages.lock.d")
    commit(ws)
    assert "does not exist" in keymint("diff", "HEAD:./", ".", cwd=ws).err


def test_what_the_documentation_says(keymint, tmp_path: Path) -> None:
    text = (CHECKOUT / "docs/packages.md").read_text()
    policy, shipped = re.findall("```xml\n(.*?)```", text, re.DOTALL)
    ship(tmp_path / "prefix", {"controller.xml": shipped})
    (tmp_path / "policy.xml").write_text(policy)
    env = {"AMENT_PREFIX_PATH": str(tmp_path / "prefix")}
    commands = [line.split()[2:] for line in text.splitlines() if line.startswith("$ keymint")]
    assert [command[0] for command in commands] == ["plugins", "provision", "provision"]
    plugins, refused, accepted = (keymint(*command, env=env) for command in commands)
    assert "nav2_bringup  controller.xml  -  " in plugins.out
    assert refused.out == "".join(
        f"{line}\n" for line in text.splitlines() if re.match(r"/robot1/c|  \+ |1 subject", line)
    )
    assert refused.err.split("(")[0] in text
    assert accepted.code == 0
    assert keymint("check", "-w", "my_ws", env=env).code == 0


@pytest.mark.parametrize("verb", [["create", "--all"], ["create", "/robot/controller"], ["provision", "policy.xml"]])
def test_an_acceptance_does_not_outlive_its_include(keymint, accepted: Path, tmp_path: Path, verb: list[str]) -> None:
    ship(tmp_path / "prefix", {"other.xml": fragment(topic("/other"))})
    ship(tmp_path / "prefix", {"one.xml": fragment(topic("/one"))}, "second")
    (tmp_path / "policy.xml").write_text(including(HREF, f"package://{PACKAGE}/other.xml", "package://second/one.xml"))
    assert keymint("create", "--all", "-w", "ws", *ACCEPT, "--trust-package", "second").code == 0
    lock, copies = accepted / "profile/packages.lock.xml", accepted / "profile/packages.lock.d"
    (tmp_path / "policy.xml").write_text(including(f"package://{PACKAGE}/other.xml"))
    outcome = keymint(*verb, "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert f"dropped 1 file of the package {PACKAGE}, no longer included" in outcome.out
    assert re.findall('(?:name|path)="(.*?)"', lock.read_text()) == [PACKAGE, "other.xml"]
    assert [path.name for path in copies.rglob("*.xml")] == ["other.xml"]
    assert keymint(*verb, "-w", "ws").out.startswith("nothing to do")
    (tmp_path / "policy.xml").write_text(including())
    assert keymint(*verb, "-w", "ws", "--yes").code == 0
    assert not lock.exists()
    assert not any(path.is_file() for path in copies.rglob("*"))
    (tmp_path / "policy.xml").write_text(including(HREF))
    assert "was not accepted yet" in keymint(*verb, "-w", "ws").err  # what was accepted once is asked for again
