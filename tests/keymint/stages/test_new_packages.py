# SPDX-License-Identifier: Apache-2.0
"""What is planned for a package of which nothing is there is what the stages plan with a view of all files."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
from keymint_ros import RosPackageType
from keymint_ros.package_reader import load, load_like

from comarmor.errors import Origin
from keymint.api import KeySpec, Package
from keymint.ir import SubjectRules
from keymint.life.register import loaded_register
from keymint.pki import keys
from keymint.stages.create import CreateStage
from keymint.stages.enclave_forms import EnclaveForm
from keymint.stages.work import Forms, NewPackage, NewPackages, PackagePlan
from keymint.view.stamps import Stamp, State, load as load_record
from tests.conftest import Outcome, snapshot
from tests.effort import tries
from tests.keymint.stages.keystores import another_key

Keymint = Callable[..., Outcome]
RANDOM = {"cert.pem", "key.pem", "permissions.p7s", "governance.p7s"}
"""Files of an enclave that depend on a key, a serial number or a moment."""
PROFILE = """<profile name="p{n}"><attachment>/robot{n}/{role}</attachment>
<ros_topic qualifier="ALLOW"><attachment>/robot{n}/chatter{wild}</attachment><attachment>/map</attachment>
<permissions><{permission}/></permissions></ros_topic>
<ros_topic qualifier="DENY"><attachment>/robot{n}/chatter_secret</attachment>
<permissions><{permission}/></permissions></ros_topic></profile>
"""
FIRST = """<profile name="first"><attachment>/first</attachment><ros_topic qualifier="ALLOW">
<attachment>/map</attachment><permissions><ros_publish/></permissions></ros_topic></profile>
"""
SIZE = 30
ODD = {
    "sources": ("src/{}/package.defaults/x.xml", "<x/>"),
    "document": ("build/{}/governance.xml", "<edited/>"),
    "enclave": ("install/enclaves/{}/note.txt", "mine"),
    "key": ("private/identities/{}/key.pem", ""),
}
"""Something of a package that is there before: a path, and its content."""


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The packages that are planned at once, as they are planned."""
    names: list[str] = []
    create = CreateStage.new

    def seen(self: CreateStage, new: NewPackage) -> PackagePlan:
        names.append(new.name)
        return create(self, new)

    monkeypatch.setattr(CreateStage, "new", seen)
    return names


@pytest.fixture
def filled(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether each enclave that was filled in from a form is what form and package say."""
    found: list[bool] = []
    holds = EnclaveForm.holds

    def seen(self: EnclaveForm, new: NewPackage, chains: Mapping[str, bytes]) -> bool:
        found.append(holds(self, new, chains))
        return found[-1]

    monkeypatch.setattr(EnclaveForm, "holds", seen)
    return found


def policy(size: int, order: random.Random) -> str:
    """Return a policy with talkers and listeners, some of them with a wildcard, in any order."""
    roles = ("talker", "ros_publish"), ("listener", "ros_subscribe")
    profiles = [
        PROFILE.format(n=n, role=roles[n % 2][0], permission=roles[n % 2][1], wild="_*" if n % 3 else "")
        for n in range(size)
    ]
    order.shuffle(profiles)
    return f"<profiles>{FIRST}{''.join(profiles)}</profiles>\n"


def same_files(one: Path, other: Path) -> None:
    """Compare two workspaces, but for what depends on keys, serial numbers and moments."""
    first, second = snapshot(one), snapshot(other)
    assert first.keys() == second.keys()
    for name, (mode, _, content) in first.items():
        assert mode == second[name][0], name
        fixed = name.rpartition("/")[2] not in RANDOM and not name.startswith((".keymint", "private/register"))
        assert not fixed or content == second[name][2], name


def record(workspace: Path) -> State:
    """Return the record of a workspace."""
    return load_record((workspace / ".keymint/state.json").read_bytes())


def without_random(stamp: Stamp) -> Stamp:
    """Return a stamp without the digests of what is random."""
    outputs = {file: "" if file in RANDOM else text for file, text in stamp.outputs.items()}
    return replace(stamp, inputs="", outputs=outputs)


def same_record(one: State, other: State) -> None:
    """Compare two records likewise."""
    assert {stage: list(each) for stage, each in one.stamps.items()} == {
        stage: list(each) for stage, each in other.stamps.items()
    }
    for stage, of_stage in one.stamps.items():
        for name, stamp in of_stage.items():
            known = other.stamps[stage][name]
            fixed = {"create", "build"}
            assert stage.endswith("-keys") or stage in fixed or without_random(stamp) == without_random(known)
            assert stage not in fixed or stamp == known, (stage, name)


def register(workspace: Path) -> tuple[list[Any], list[Any]]:
    """Return what the register says of certificates and rights."""
    (path,) = (each for each in (workspace / "private").glob("register*") if each.is_file())
    found = loaded_register(path.read_bytes(), Origin("register"))
    issued = [replace(each, serial=0, key="", issued=None) for each in found.certificates.values()]
    return sorted(map(repr, issued)), sorted((each.name, each.subject, each.content) for each in found.rights)


@pytest.mark.parametrize("seed", range(tries(3, 20)))
def test_new_packages_are_planned_as_one_by_one(
    keymint: Keymint,
    tmp_path: Path,
    planned: list[str],
    filled: list[bool],
    monkeypatch: pytest.MonkeyPatch,
    seed: int,
) -> None:
    draw = random.Random(seed)
    (tmp_path / "p.xml").write_text(f"<profiles>{FIRST}</profiles>")
    assert keymint("provision", "p.xml", "-w", "ws").code == 0
    assert planned == ["first"]
    odd = {f"robot{n}/{'listener' if n % 2 else 'talker'}": kind for n, kind in enumerate(ODD) if draw.random() < 0.7}
    for name, kind in odd.items():
        path, content = ODD[kind]
        file = tmp_path / "ws" / path.format(name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)
        if kind == "key":
            another_key(tmp_path / "ws", file)
    shutil.copytree(tmp_path / "ws", tmp_path / "before", symlinks=True)
    (tmp_path / "p.xml").write_text(policy(SIZE, draw))
    reports, states = [], []
    for alone in (False, True):
        planned.clear()
        filled.clear()
        with monkeypatch.context() as patch:
            if alone:
                patch.setattr(NewPackages, "of", lambda *_: None)
            done = keymint("provision", "p.xml", "-w", "ws", "-f", "--json")
        assert done.code == 0, done.err
        expected = {f"robot{n}/{'listener' if n % 2 else 'talker'}" for n in range(SIZE)} - odd.keys()
        assert {*planned} == (set() if alone else expected)
        assert len(filled) >= (0 if alone else SIZE - 16)  # of each of four kinds, the first three are made in full
        assert all(filled)
        reports.append(json.loads(done.out))
        states.append(record(tmp_path / "ws"))
        (tmp_path / "ws").rename(tmp_path / ("alone" if alone else "at_once"))
        if not alone:
            shutil.copytree(tmp_path / "before", tmp_path / "ws", symlinks=True)
    assert reports[0] == reports[1]
    same_files(tmp_path / "at_once", tmp_path / "alone")
    same_record(*states)
    assert register(tmp_path / "at_once") == register(tmp_path / "alone")


def test_what_was_planned_at_once_is_unchanged_for_each_stage(
    keymint: Keymint, tmp_path: Path, planned: list[str]
) -> None:
    (tmp_path / "p.xml").write_text(policy(6, random.Random(0)))
    assert keymint("provision", "p.xml", "-w", "ws").code == 0
    assert len(planned) == 7
    before = snapshot(tmp_path / "ws")
    for command in (("create", "--all"), ("build",), ("install",)):
        done = keymint(*command, "-w", "ws", "--json")
        steps = json.loads(done.out)["steps"]
        assert {each["action"] for each in steps} == {"unchanged"}, done.out
    assert snapshot(tmp_path / "ws") == before
    known = record(tmp_path / "ws").stamps["prove"]
    assert keymint("prove", "-w", "ws").code == 0
    assert known.items() <= record(tmp_path / "ws").stamps["prove"].items()
    assert keymint("check", "-w", "ws").code == 0


@pytest.mark.parametrize("options", [("--no-prove",), ("--valid-for", "P30D"), ("--allow-vendor-specific",)])
def test_what_a_stage_does_otherwise_is_planned_one_by_one(
    keymint: Keymint, tmp_path: Path, planned: list[str], options: tuple[str, ...]
) -> None:
    (tmp_path / "p.xml").write_text(policy(3, random.Random(0)))
    assert keymint("provision", "p.xml", "-w", "ws", *options).code == 0
    if options[0] != "--valid-for":  # which makes the profile of a new workspace
        assert planned == []


def test_a_revoked_package_is_planned_one_by_one(keymint: Keymint, tmp_path: Path, planned: list[str]) -> None:
    (tmp_path / "p.xml").write_text(policy(3, random.Random(0)))
    assert keymint("provision", "p.xml", "-w", "ws").code == 0
    assert keymint("revoke", "robot1/listener", "--reason", "superseded", "-w", "ws", "--yes").code == 0
    for space in ("src", "build", "install/enclaves", "private/identities"):
        shutil.rmtree(tmp_path / "ws" / space / "robot1", ignore_errors=True)
    planned.clear()
    keymint("provision", "p.xml", "-w", "ws")
    assert planned == []


def test_a_package_that_is_made_from_another_one_is_as_it_is_read(
    keymint: Keymint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others, names = list[Any](), list[str]()

    def loaded(*arguments: Any, **options: Any) -> Any:
        others[:] = arguments[4:]
        return load(*arguments, **options)

    def made(profile: Any, like: Any, sources: Any, name: str, folder: str, files: Any) -> Any:
        found = load_like(profile, like, sources, name, folder, files)
        if found is None:  # the first one
            return None
        read = load(profile, name, folder, files, *others)
        for each in fields(Package):
            assert getattr(found, each.name) == getattr(read, each.name), each.name
        names.append(name)
        return found

    monkeypatch.setattr(RosPackageType, "load", staticmethod(loaded))
    monkeypatch.setattr(RosPackageType, "load_like", staticmethod(made))
    (tmp_path / "p.xml").write_text(policy(SIZE, random.Random(0)))
    assert keymint("provision", "p.xml", "-w", "ws").code == 0
    assert len(names) == SIZE


def test_a_member_that_is_planned_twice_has_not_all_in_common_with_itself() -> None:
    forms, found = Forms(), list[tuple[str, str]]()
    members = [NewPackage(name, SubjectRules(f"/{name}", ()), forms, "") for name in ("a", "a", "b", "c")]
    for each in members:
        each.kind = "kind"
        forms.learn("stage", each, each.name, lambda *pair: found.append(pair) or pair)
    assert found == [("a", "b")]
    assert forms.of("stage", "kind") == ("a", "b")


def other_key(content: bytes) -> bytes:
    del content
    return keys.to_pem(keys.generate(KeySpec("ec", "SECP256R1")))


ALTERED: Mapping[str, Callable[[bytes], bytes]] = {
    "cert.pem": lambda content: content[:300] + (b"A" if content[300:301] != b"A" else b"B") + content[301:],
    "key.pem": other_key,
    "permissions.p7s": lambda content: content.replace(b"rt/robot", b"rt/rowot"),
    "governance.p7s": lambda content: content.replace(b">ENCRYPT<", b">NONE<"),
    "identity_ca.cert.pem": lambda _: b"",
    "permissions_ca.cert.pem": lambda content: content + content,
}
"""What becomes of a file of an enclave between its signature and the proof."""


@pytest.mark.parametrize("file", ALTERED)
def test_the_proof_reads_the_files_that_will_be_written(
    keymint: Keymint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    fill, last = EnclaveForm.fill, list[str]()

    def altered(self: EnclaveForm, new: NewPackage, *others: Any) -> Any:
        files, issued, rights = fill(self, new, *others)
        if new.name == "robot28/talker":
            last.append(new.name)
            files[file] = replace(files[file], given=ALTERED[file](files[file].content))
        return files, issued, rights

    monkeypatch.setattr(EnclaveForm, "fill", altered)
    (tmp_path / "p.xml").write_text(policy(SIZE, random.Random(0)))
    done = keymint("provision", "p.xml", "-w", "ws")
    assert last == ["robot28/talker"]
    assert (done.code, "/robot28/talker" in done.err) == (3, True), done.err
    assert not (tmp_path / "ws/install").exists()
    assert not (tmp_path / "ws/src/robot0").exists()
