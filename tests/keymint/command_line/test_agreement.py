# SPDX-License-Identifier: Apache-2.0
"""Who gains and loses which right is shown before it happens, and nothing is lost by mistake."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from keymint.client import Client, UnconfirmedError
from keymint.store import group_commit
from keymint.store.staged import Exchange
from tests.conftest import Outcome, snapshot
from tests.keymint.run.terminal import on_terminal

Rights = Mapping[str, Sequence[str]]


def rule(text: str) -> str:
    """Return a rule: ``publish /image``, with a ``!`` in front to deny it."""
    permission, name = text.lstrip("!").split()
    kind = {"publish": "topic", "subscribe": "topic", "call": "service", "execute": "service"}.get(
        permission, permission
    )
    kind = {"request": "action", "read": "parameter"}.get(kind, kind)
    effect = "DENY" if text.startswith("!") else "ALLOW"
    return (
        f'<ros_{kind} qualifier="{effect}"><attachment>{name}</attachment>'
        f"<permissions><ros_{permission}/></permissions></ros_{kind}>"
    )


def policy_of(subjects: Rights, names: str = "p") -> str:
    """Return a policy in which each subject has a profile, whose name begins with a text."""
    profiles = (
        f'<profile name="{names}{subject}"><attachment>{subject}</attachment>{"".join(map(rule, rights))}</profile>\n'
        for subject, rights in subjects.items()
    )
    return f"<profiles>\n{''.join(profiles)}</profiles>\n"


def fleet(size: int, losing: int = 0) -> Rights:
    return {f"/r{at}": ["publish /a"] if at < losing else ["publish /a", "publish /b"] for at in range(size)}


class Fleet:
    """A workspace, and its policy beside it."""

    def __init__(self, keymint: Callable[..., Outcome], folder: Path, transports: Sequence[str] = ()) -> None:
        self.keymint = keymint
        self.folder = folder
        self.root = folder / "ws"
        self.options = [word for each in transports for word in ("--transport", each)]

    def write(self, subjects: Rights, file: str = "policy.xml", **options: str) -> Path:
        path = self.folder / file
        path.parent.mkdir(exist_ok=True)
        path.write_text(policy_of(subjects, **options))
        return path

    def provision(self, *options: object, file: str = "policy.xml") -> Outcome:
        return self.keymint("provision", file, "-w", "ws", *options)

    def start(self, subjects: Rights) -> None:
        self.write(subjects)
        made = self.provision(*self.options)
        assert made.code == 0, made.err
        assert "rights" not in made.err
        assert not made.out.startswith("/")

    def stops(self, *options: object, codes: Sequence[str], file: str = "policy.xml", verb: Sequence[str] = ()) -> dict:
        """Require that a run ends with 3 and writes nothing, and return its result."""
        before = snapshot(self.folder)
        words = [*verb, "-w", "ws"] if verb else ["provision", file, "-w", "ws"]
        outcome = self.keymint(*words, "--json", *options)
        assert outcome.code == 3, outcome.out
        assert outcome.codes() == [*codes, "not-confirmed"]
        quiet = self.keymint(*words, "-q", *options)
        assert (quiet.code, quiet.out) == (3, "")
        assert quiet.err.count("error: ") == len(codes) + 1
        assert snapshot(self.folder) == before
        return outcome.document["result"]

    def grants(self, name: str) -> str:
        return (self.root / f"install/enclaves/{name}/permissions.xml").read_text()


@pytest.fixture
def ws(keymint: Callable[..., Outcome], tmp_path: Path) -> Fleet:
    return Fleet(keymint, tmp_path)


def changes(result: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return what each subject gains and loses."""
    return {
        each["subject"]: [
            f"{'+' if one['change'] == 'gains' else '-'} {one['permission'].removeprefix('ros_')} {one['pattern']}"
            for one in each["changes"]
        ]
        for each in result["rights"]
    }


TALKERS: Rights = {"/talker": ["publish /chatter", "subscribe /clock"], "/listener": ["subscribe /chatter"]}


# -- what a dry run shows ----------------------------------------------------------------------------------------------


def test_a_dry_run_shows_rights_and_then_files(ws: Fleet) -> None:
    ws.start(TALKERS)
    ws.write({"/talker": ["publish /chatter", "publish /image"], "/listener": ["subscribe /chatter"], "/new": []})
    before = snapshot(ws.root)
    outcome = ws.provision("--dry-run")
    assert outcome.code == 0, outcome.err
    lines = outcome.out.splitlines()
    assert lines[:6] == [
        "/new (new), without any permission",
        "/talker:",
        "  + ros_publish /image (policy.xml:2)",
        "  - ros_subscribe /clock (ws/install/enclaves/talker/permissions.p7s:27)",
        "1 subject gains, 1 loses",
        "created   create      new",
    ]
    assert snapshot(ws.root) == before
    found = ws.provision("--dry-run", "--json").document
    assert found["result"]["rights"][1] == {
        "subject": "/talker",
        "stands_for": None,
        "except": [],
        "applies": {"before": True, "after": True},
        "changes": [
            {
                "change": "gains", "kind": "ros_topic", "permission": "ros_publish", "pattern": "/image", "whole": True,
                "example": "/image", "rule": {"file": "policy.xml", "line": 2}, "unknown": None, "build_type": None,
            },
            {
                "change": "loses", "kind": "ros_topic", "permission": "ros_subscribe", "pattern": "/clock",
                "whole": True, "example": "/clock",
                "rule": {"file": "ws/install/enclaves/talker/permissions.p7s", "line": 27}, "unknown": None,
                "build_type": None,
            },
        ],
    }  # fmt: skip


def test_every_kind_of_right_is_shown_as_the_policy_says_it(ws: Fleet) -> None:
    own = ["publish /t", "call /s", "execute /x", "request /act", "read /node"]
    ws.start({"/a": ["publish /kept"], "/b": [*own, "publish /kept"]})
    ws.write({"/a": [*own, "publish /kept"], "/b": ["publish /kept"]})
    found = changes(ws.provision("--dry-run", "--json").document["result"])
    assert sorted(found["/a"]) == sorted(f"+ {each}" for each in own)
    assert sorted(found["/b"]) == sorted(f"- {each}" for each in own)


def test_wildcards_and_denials(ws: Fleet) -> None:
    ws.start({"/a": ["publish /x/*"], "/b": ["publish /x/*", "!publish /x/secret"]})
    ws.write({"/a": ["publish /x/*", "!publish /x/secret"], "/b": ["publish /x/*"]})
    found = changes(ws.provision("--dry-run", "--json").document["result"])
    assert found == {"/a": ["- publish /x/secret"], "/b": ["+ publish /x/secret"]}


def test_a_changed_domain(ws: Fleet) -> None:
    ws.start(TALKERS)
    defaults = ws.root / "profile/package.defaults/permissions.xml"
    text = defaults.read_text()
    assert "<id>0</id>" in text
    defaults.write_text(text.replace("<id>0</id>", "<id>5</id>"))
    governance = ws.root / "profile/package.defaults/governance.xml"
    governance.write_text(governance.read_text().replace("<id>0</id>", "<id>5</id>"))
    outcome = ws.provision("--dry-run")
    assert outcome.out.splitlines()[:4] == ["/listener:", "  - domain 0", "  + domain 5", "/talker:"]
    assert ws.provision().code == 0  # they are two


def test_a_renamed_subject_loses_and_another_one_gains(ws: Fleet) -> None:
    ws.start(TALKERS)
    ws.write({"/speaker": TALKERS["/talker"], "/listener": TALKERS["/listener"]})
    outcome = ws.provision("--dry-run", "--json")
    assert changes(outcome.document["result"]) == {
        "/speaker": ["+ publish /chatter", "+ subscribe /clock"],
        "/talker": ["- publish /chatter", "- subscribe /clock"],
    }
    assert "subject-stripped" in outcome.codes()
    ws.stops(codes=["subject-stripped"])
    shutil.rmtree(ws.root / "src/talker")  # it is gone, and does not remain
    assert ws.provision().code == 0


def test_a_cold_provision_and_an_unchanged_one_compare_nothing(ws: Fleet) -> None:
    ws.write(TALKERS)
    script = (
        "import sys\nfrom keymint import cli\ncode = cli.main(sys.argv[1:])\n"
        "assert 'keymint.stages.changed_rights' not in sys.modules\nsys.exit(code)"
    )
    for options in (("--dry-run",), (), (), ("-v",)):
        call = [sys.executable, "-c", script, "provision", "policy.xml", "-w", "ws", *options]
        done = subprocess.run(call, cwd=ws.folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert ws.provision("--json").document["result"] == {"rights": []}


def test_processes_find_the_same(ws: Fleet) -> None:
    ws.start(fleet(70))
    ws.write(fleet(70, losing=70))
    alone, together = (ws.provision("--dry-run", "--json", "-j", jobs).document["result"] for jobs in (1, 2))
    assert alone == together
    assert len(alone["rights"]) == 70
    assert ws.provision("-j", 2, "--yes").code == 0


def test_a_run_says_how_many_gain_and_lose(ws: Fleet) -> None:
    ws.start(TALKERS)
    more = {**TALKERS, "/talker": ["publish /chatter", "publish /image"]}
    ws.write(more)
    line = "1 subject gains, 1 loses (-v shows which; --dry-run does so before)\n"
    assert ws.provision().out.startswith(line)
    assert ws.provision().out.startswith("nothing to do")
    ws.write({**more, "/talker": ["publish /chatter"], "/new": ["publish /x"]})
    shown = ws.provision("-v").out
    assert shown.startswith("/talker:\n  - ros_publish /image (")
    assert "\nno subjects gain, 1 loses\n" in shown
    ws.write({**more, "/talker": []})
    assert ws.provision("--yes").out.startswith("no subjects gain, 2 lose (")


def test_a_dry_run_says_that_the_run_would_ask(ws: Fleet) -> None:
    ws.start(fleet(5))
    ws.write(fleet(5, losing=5))
    dry = ws.provision("--dry-run")
    assert (dry.code, "--dry-run" in dry.err) == (0, False)
    assert "warning: the run itself asks first (if this is wanted, add --yes) [not-confirmed]" in dry.err
    assert "not-confirmed" not in ws.provision("--dry-run", "--yes").err
    ws.write(fleet(5, losing=4))
    assert "not-confirmed" not in ws.provision("--dry-run").err


def test_a_stop_says_how_many_lines_it_leaves_out(ws: Fleet) -> None:
    ws.start(fleet(30))
    ws.write(fleet(30, losing=30))
    lines = ws.provision().out.splitlines()
    assert lines[-2:] == ["… and 20 lines more; --dry-run shows all", "no subjects gain, 30 lose"]
    assert len(lines) == 42
    assert len(ws.provision("-v").out.splitlines()) == 61


# -- when it stops -----------------------------------------------------------------------------------------------------


def test_a_wrong_policy_strips_nobody(ws: Fleet) -> None:
    """Mistake 26: it exited with 0, and with -q said nothing."""
    ws.start(TALKERS)
    ws.write({"/camera": ["publish /image"]}, "other.xml", names="other")
    result = ws.stops(codes=["policy-replaced", "subject-stripped"], file="other.xml")
    assert [each["subject"] for each in result["rights"] if not each["applies"]["after"]] == ["/listener", "/talker"]
    outcome = ws.provision(file="other.xml")
    assert "/talker (nothing is left):\n  - ros_publish /chatter (ws/install/" in outcome.out
    assert outcome.err == (
        "other.xml: error: is another policy than the workspace has: its profiles are other/camera, and those before "
        "are p/listener, p/talker (is it the right file, and the right workspace?) [policy-replaced]\n"
        "error: this takes all rights from 2 subjects: /listener, /talker (is it the right policy? name them in it; "
        "'keymint remove NAME -w ws' is for those that are gone) [subject-stripped]\n"
        "error: nothing was written (if this is wanted, add --yes) [not-confirmed]\n"
    )
    outcome = ws.provision("--yes", file="other.xml")
    assert outcome.code == 0, outcome.err
    assert "warning: this takes all rights from 2 subjects" in outcome.err
    assert "<topic>" not in ws.grants("talker")
    assert ws.provision(file="other.xml").out.startswith("nothing to do")


def test_a_subject_that_loses_a_part_stops_nobody(ws: Fleet) -> None:
    ws.start(TALKERS)
    ws.write({**TALKERS, "/talker": ["subscribe /clock"]})
    assert ws.provision().code == 0
    ws.write({**TALKERS, "/talker": ["publish /chat"]})  # another name for what it does
    assert ws.provision().code == 0


@pytest.mark.parametrize("rights", [[], ["!publish /chatter"], ["publish /chatter", "!publish /*"]])
def test_a_subject_that_is_left_with_nothing_stops(ws: Fleet, rights: list[str]) -> None:
    ws.start(TALKERS)
    ws.write({**TALKERS, "/talker": rights})
    ws.stops(codes=["subject-stripped"])


@pytest.mark.parametrize(("size", "losing", "stops"), [(5, 4, False), (5, 5, True), (50, 5, True), (51, 5, False)])
def test_many_that_lose_something(ws: Fleet, size: int, losing: int, stops: bool) -> None:
    ws.start(fleet(size))
    ws.write(fleet(size, losing))
    if stops:
        ws.stops(codes=["rights-lost"])
        err = ws.provision().err
        assert f"this takes rights from {losing} of {size} subjects: /r0, /r1" in err
    else:
        assert ws.provision().code == 0


@pytest.mark.parametrize("together", [True, False])
def test_subjects_that_are_about_to_be_installed_are_not_among_those_that_could_lose(ws: Fleet, together: bool) -> None:
    ws.start(fleet(11))
    ws.write(fleet(60, losing=5))
    if together:
        assert "this takes rights from 5 of 11 subjects" in ws.provision().err
        return
    created = ws.keymint("create", "--all", "-w", "ws", "--yes")
    assert created.code == 0, created.err
    assert "this takes rights from 5 of 11 subjects" in created.err
    assert ws.keymint("build", "-w", "ws").code == 0
    assert "this takes rights from 5 of 11 subjects" in ws.keymint("install", "-w", "ws").err


def test_gains_and_new_subjects_do_not_stop(ws: Fleet) -> None:
    ws.start(fleet(6))
    more = {each: [*own, "publish /c"] for each, own in fleet(8).items()}
    ws.write(more)
    outcome = ws.provision("--json")
    assert outcome.code == 0
    assert {*changes(outcome.document["result"])} == {f"/r{at}" for at in range(6)}


# -- which policy it is ------------------------------------------------------------------------------------------------


def test_another_policy_for_the_same_subjects_stops(ws: Fleet) -> None:
    ws.start(TALKERS)
    ws.write({each: [*own, "publish /more"] for each, own in TALKERS.items()}, "other.xml", names="other")
    ws.stops(codes=["policy-replaced"], file="other.xml")


@pytest.mark.parametrize("file", ["renamed.xml", "elsewhere/policy.xml"])
@pytest.mark.parametrize("subjects", [TALKERS, {**TALKERS, "/third": ["publish /x"]}], ids=["same", "edited"])
def test_a_policy_that_moved_is_the_same(ws: Fleet, file: str, subjects: Rights) -> None:
    ws.start(TALKERS)
    (ws.folder / "policy.xml").unlink()
    ws.write(subjects, file)
    outcome = ws.provision(file=file)
    assert outcome.code == 0, outcome.err


def test_a_checkout_that_moved_is_the_same(keymint: Callable[..., Outcome], tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    first = Fleet(keymint, tmp_path / "one")
    first.write(TALKERS)
    assert keymint("provision", "policy.xml", "-w", "ws", cwd=first.folder).code == 0
    first.folder.rename(tmp_path / "two")
    second = Fleet(keymint, tmp_path / "two")
    second.write({**TALKERS, "/third": ["publish /x"]})
    outcome = keymint("provision", "policy.xml", "-w", "ws", cwd=second.folder)
    assert outcome.code == 0, outcome.err
    second.write({"/camera": ["publish /image"], **TALKERS, "/third": ["publish /y"]}, names="other")
    assert keymint("provision", "policy.xml", "-w", "ws", cwd=second.folder).code == 0  # the same subjects, renamed
    second.write({"/camera": ["publish /image"]}, names="third")
    assert keymint("provision", "policy.xml", "-w", "ws", cwd=second.folder).code == 3


def test_renamed_profiles_of_a_policy_in_place_are_the_same_policy(ws: Fleet) -> None:
    ws.start(TALKERS)
    ws.write(TALKERS, names="better")
    assert ws.provision().code == 0
    ws.write({"/camera": ["publish /image"]}, names="other")
    ws.stops(codes=["policy-replaced", "subject-stripped"])


# -- on a terminal, and stage by stage ---------------------------------------------------------------------------------


@pytest.mark.parametrize("answer", ["y", "n"])
def test_it_asks_on_a_terminal(ws: Fleet, answer: str) -> None:
    ws.start(TALKERS)
    ws.write({"/listener": TALKERS["/listener"]})
    before = snapshot(ws.folder)
    outcome = on_terminal(["provision", "policy.xml", "-w", "ws"], ws.folder, f"{answer}\n")
    assert outcome.err.count("Go on? [y/N] ") == 1
    assert "warning: this takes all rights from /talker" in outcome.err
    assert "/talker (nothing is left):\n  - ros_publish /chatter" in outcome.out
    if answer == "y":
        assert outcome.code == 0, outcome.err
        assert "<topic>" not in ws.grants("talker")
    else:
        assert outcome.code == 3
        assert snapshot(ws.folder) == before


def test_the_stages_stop_one_by_one(ws: Fleet) -> None:
    ws.start(TALKERS)
    ws.write({**TALKERS, "/talker": []})
    dry = ws.keymint("create", "--all", "-w", "ws", "--dry-run")
    assert dry.out.startswith("/talker (nothing is left):\n  - ros_publish /chatter (ws/install/")
    assert dry.code == 0
    ws.stops(codes=["subject-stripped"], verb=["create", "--all"])
    ws.stops(codes=["subject-stripped"], verb=["create", "talker"])
    assert ws.keymint("create", "--all", "-w", "ws", "--yes").code == 0
    assert ws.keymint("create", "--all", "-w", "ws").code == 0  # nothing is left to do
    assert ws.keymint("build", "-w", "ws").code == 0
    assert changes(ws.stops(codes=["subject-stripped"], verb=["install"])) == {
        "/talker": ["- publish /chatter", "- subscribe /clock"]
    }
    assert "<topic>rt/chatter" in ws.grants("talker")
    assert ws.keymint("install", "-w", "ws", "listener").code == 0
    outcome = ws.keymint("install", "-w", "ws", "--dry-run")
    assert outcome.out.startswith("/talker (nothing is left):\n")
    ws.stops(codes=["subject-stripped"], verb=["renew", "talker"])
    assert ws.keymint("install", "-w", "ws", "--yes").code == 0
    assert "<topic>" not in ws.grants("talker")


def test_what_was_not_installed_is_created_without_a_question(ws: Fleet) -> None:
    ws.write(TALKERS)
    assert ws.keymint("init", "ws", "--policy", "policy.xml").code == 0
    assert ws.keymint("create", "--all", "-w", "ws", "--dry-run").out.startswith("created ")
    assert ws.keymint("create", "--all", "-w", "ws").code == 0
    ws.write({**TALKERS, "/talker": []})
    assert ws.keymint("create", "--all", "-w", "ws").code == 0


def test_documents_that_a_person_edited_are_what_counts(ws: Fleet) -> None:
    """What is installed is what build/ has, whatever the policy says."""
    ws.start(TALKERS)
    built = ws.root / "build/talker/permissions.xml"
    built.write_text(built.read_text().replace("rt/chatter", "rt/gossip"))
    outcome = ws.keymint("install", "-w", "ws", "--no-prove", "--dry-run", "--json")
    assert changes(outcome.document["result"]) == {"/talker": ["+ publish /gossip", "- publish /chatter"]}


# -- what is there already ---------------------------------------------------------------------------------------------


def damage(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"rt/chatter", b"rt/chattel"))


def test_what_cannot_be_read_is_unknown_and_stops_nobody(ws: Fleet) -> None:
    ws.start(TALKERS)
    damage(ws.root / "install/enclaves/talker/permissions.p7s")
    ws.write({**TALKERS, "/talker": ["publish /chatter"], "/listener": ["subscribe /x"]})
    dry = ws.provision("--dry-run")
    assert "/talker:\n  ? ws/install/enclaves/talker/permissions.p7s: " in dry.out
    outcome = ws.provision("--json")
    assert outcome.code == 0
    assert "rights-unread" in outcome.codes()
    listener, talker = outcome.document["result"]["rights"]
    assert "permissions.p7s" in talker["changes"][0]["unknown"]
    assert not any(each["unknown"] for each in listener["changes"])
    assert "rights-unread" not in ws.provision("--json").codes()


def test_what_cannot_be_read_stops_if_nothing_is_left_after_it(ws: Fleet) -> None:
    ws.start(TALKERS)
    damage(ws.root / "install/enclaves/talker/permissions.p7s")
    ws.write({**TALKERS, "/talker": []})
    ws.stops(codes=["subject-stripped"])


@pytest.mark.parametrize("file", ["permissions.p7s", "permissions_ca.cert.pem", "cert.pem", "key.pem"])
def test_a_damaged_enclave_is_restored_without_a_question(ws: Fleet, file: str) -> None:
    ws.start(TALKERS)
    (ws.root / f"install/enclaves/talker/{file}").write_bytes(b"damaged")
    before = ws.grants("talker")
    outcome = ws.provision()
    assert outcome.code == 0, outcome.err
    assert ws.grants("talker") == before


def test_a_revoked_enclave_has_nothing_to_lose(ws: Fleet) -> None:
    ws.start(TALKERS)
    assert ws.keymint("revoke", "talker", "--reason", "key-compromise", "-w", "ws").code == 0
    ws.write({**TALKERS, "/talker": []})
    outcome = ws.provision("--json")
    assert outcome.code == 0, outcome.out
    assert outcome.document["result"]["rights"] == []


def test_new_authorities_and_new_dates_take_nothing(ws: Fleet) -> None:
    ws.start(TALKERS)
    for options in (("--new-authority", "permissions_ca"), ("--rekey", "talker")):
        outcome = ws.provision(*options, "--json")
        assert outcome.code == 0
        assert outcome.document["result"]["rights"] == []
        assert "rights-unread" not in outcome.codes()


# -- interrupted runs --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("after", ["", "policies.xml", "talker"])
def test_an_interrupted_run_asks_again_or_is_finished(ws: Fleet, monkeypatch: pytest.MonkeyPatch, after: str) -> None:
    """Who agreed need not agree once more to what is visible in part; before that nothing happened."""
    ws.start(TALKERS)
    ws.write({"/camera": ["publish /image"]}, "other.xml", names="other")
    made, seen = group_commit.make_visible, list[str]()

    def stopping(folder: int, exchange: Exchange) -> str | None:
        if exchange.name != "running" and after in ("", *seen):
            raise KeyboardInterrupt
        seen.append(exchange.name)
        return made(folder, exchange)

    with monkeypatch.context() as patch, contextlib.suppress(KeyboardInterrupt):
        patch.setattr(group_commit, "make_visible", stopping)
        assert ws.provision("--yes", file="other.xml").code == 130
    outcome = ws.provision("--json", file="other.xml")
    if after:
        assert outcome.code == 0, outcome.out
        assert "<topic>" not in ws.grants("talker")
        assert "run-interrupted" in outcome.codes()
    else:
        assert outcome.code == 3
        assert "<topic>rt/chatter" in ws.grants("talker")
    assert ws.provision("--yes", file="other.xml").code == 0
    assert ws.keymint("check", "-w", "ws").code == 0


# -- Zenoh, and programs -----------------------------------------------------------------------------------------------


def test_what_one_of_two_transports_changes_alone_is_shown_and_marked(keymint: Callable, tmp_path: Path) -> None:
    ws = Fleet(keymint, tmp_path, ["dds", "zenoh"])
    ws.start(TALKERS)
    ws.write({"/talker": ["publish /image", "subscribe /clock"], "/listener": ["subscribe /image"]})
    (ws.root / "install/enclaves/talker/permissions.p7s").write_text("garbage")
    lines = ws.provision("--dry-run").out.splitlines()
    listener, talker = lines[1:3], lines[4:7]
    assert listener == [
        "  + ros_subscribe /image (policy.xml:3)",
        "  - ros_subscribe /chatter (ws/install/enclaves/listener/permissions.p7s:22)",
    ]
    assert talker[0].startswith("  ? ws/install/enclaves/talker/permissions.p7s:1: is malformed")
    assert [each.split("[")[1] for each in talker] == ["keymint_ros2_dds only]", *["keymint_ros2_zenoh only]"] * 2]
    assert talker[1:] == [
        "  + ros_publish /image (policy.xml:2) [keymint_ros2_zenoh only]",
        "  - ros_publish /chatter (ws/install/zenoh/router.json5) [keymint_ros2_zenoh only]",
    ]


@pytest.mark.parametrize("transports", [["zenoh"], ["dds", "zenoh"]], ids="+".join)
def test_zenoh(keymint: Callable[..., Outcome], tmp_path: Path, transports: list[str]) -> None:
    ws = Fleet(keymint, tmp_path, transports)
    subjects = {**TALKERS, "/other": ["call /add", "publish /x/*", "read /node"]}
    ws.start(subjects)
    ws.write({**subjects, "/talker": ["publish /chatter", "publish /image"], "/other": ["publish /x/*", "read /node"]})
    dry = ws.provision("--dry-run", "--json")
    assert changes(dry.document["result"]) == {
        "/other": ["- call /add"],
        "/talker": ["+ publish /image", "- subscribe /clock"],
    }
    assert ws.provision().code == 0
    ws.write({**subjects, "/talker": []})
    ws.stops(codes=["subject-stripped"])
    ws.stops(codes=["subject-stripped"], verb=["create", "--all"])
    assert ws.keymint("create", "--all", "-w", "ws", "--yes").code == 0
    assert ws.keymint("build", "-w", "ws").code == 0
    ws.stops(codes=["subject-stripped"], verb=["install"])
    assert ws.keymint("install", "-w", "ws", "--yes").code == 0
    router = ws.root / "install/zenoh/router.json5"
    router.write_bytes(router.read_bytes().replace(b"0/x/", b"0/y/"))
    ws.write(subjects)
    outcome = ws.provision("--json")
    assert outcome.code == 0
    assert "rights-unread" in outcome.codes()


def test_a_program_is_told_by_an_error(ws: Fleet) -> None:
    ws.start(TALKERS)
    client = Client(ws.root)
    ws.write({**TALKERS, "/talker": []})
    before = ws.grants("talker")
    with pytest.raises(UnconfirmedError) as caught:
        client.provision("/talker")
    assert [each.code for each in caught.value.diagnostics] == ["subject-stripped", "not-confirmed"]
    assert ws.grants("talker") == before
    assert client.provision("/talker", yes=True).changed
    assert "<topic>" not in ws.grants("talker")
