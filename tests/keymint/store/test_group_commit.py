# SPDX-License-Identifier: Apache-2.0
"""What was staged is invisible until it is committed, in this or another process, and then all of it is there."""

from __future__ import annotations

import ctypes
import errno
import multiprocessing
import os
import pickle
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from keymint.errors import KeymintError
from keymint.store import file_writing, group_commit
from keymint.store.changes import File, FolderChange
from keymint.store.staged import Exchange
from keymint.store.store import Store
from tests.effort import tries

PUBLIC, SECRET = File(b"public"), File(b"secret", secret=True)
ENCLAVE = {"key.pem": SECRET, "cert.pem": PUBLIC}


def files(root: Path, *, temporary: bool = False) -> set[str]:
    """Return the paths of all files, without those that are staged."""
    found = {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}
    return {path for path in found if temporary or ".keymint-" not in path}


def changes(root: Path, *enclaves: str) -> list[FolderChange]:
    return [FolderChange(root / "install" / "enclaves" / name, ENCLAVE) for name in enclaves]


def test_what_is_staged_is_invisible_until_it_is_committed(root: Path, store: Store) -> None:
    store.change(changes(root, "old"))
    before = files(root)
    staged = store.stage([*changes(root, "old", "new"), FolderChange(root / "private", {"key.pem": SECRET})])
    assert files(root) == before
    assert len(files(root, temporary=True)) == len(before) + 5
    store.commit(staged)
    assert files(root, temporary=True) == {
        *(f"install/enclaves/{name}/{file}" for name in ("old", "new") for file in ENCLAVE),
        "private/key.pem",
    }


def test_what_is_discarded_leaves_nothing(root: Path, store: Store) -> None:
    store.change(changes(root, "old"))
    before = files(root)
    staged = store.stage(changes(root, "old", "old/inner", "new"))
    store.discard(staged)
    assert files(root, temporary=True) == before
    store.discard(staged)
    with pytest.raises(KeymintError, match="No such file"):
        store.commit(staged)
    assert files(root, temporary=True) == before


def _stage(store: Store, listed: list[FolderChange], sending: Any) -> None:
    sending.send_bytes(pickle.dumps(store.stage(listed)))


@pytest.mark.parametrize("together", [True, False])
def test_processes_stage_and_one_commits(root: Path, store: Store, together: bool) -> None:
    if not together:
        (root / "install" / "enclaves").mkdir(parents=True)
    fork = multiprocessing.get_context("fork")
    staged: list[Exchange] = []
    for number in range(3):
        receiving, sending = fork.Pipe(duplex=False)
        process = fork.Process(target=_stage, args=(store, changes(root, f"{number}/a", f"{number}/b"), sending))
        process.start()
        staged += pickle.loads(receiving.recv_bytes())
        process.join()
    assert files(root) == set()
    store.commit(staged)
    expected = {f"install/enclaves/{number}/{name}/{file}" for number in range(3) for name in "ab" for file in ENCLAVE}
    assert files(root, temporary=True) == expected


def test_a_merged_folder_is_closed_if_one_of_both_is_private(root: Path, store: Store) -> None:
    folder = root / "install" / "a"
    staged = [
        *store.stage([FolderChange(folder, {"one": PUBLIC})]),
        *store.stage([FolderChange(folder, {"two": SECRET})]),
    ]
    store.commit(staged)
    assert {path.name for path in folder.iterdir()} == {"one", "two"}
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("unable", [0, errno.EINVAL])
@pytest.mark.parametrize("first", [True, False])
def test_what_another_process_staged_inside_a_replaced_folder_moves_along(
    root: Path, store: Store, first: bool, unable: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    if unable:
        monkeypatch.setattr("keymint.store.group_commit.exchange_names", refuse(unable))
    store.change([*changes(root, "robot", "other"), FolderChange(root / "install" / "enclaves", {"g.xml": PUBLIC})])
    shared = FolderChange(root / "install" / "enclaves", {"g.xml": File(b"new"), "g.p7s": File(b"new")})
    inner = [
        FolderChange(root / "install" / "enclaves" / "robot", {name: File(b"new") for name in ENCLAVE}),
        FolderChange(root / "install" / "enclaves" / "other", {"cert.pem": File(b"new")}),
        *changes(root, "more"),
    ]
    staged = {number: store.stage(listed) for number, listed in (((0, [shared]), (1, inner))[:: 1 if first else -1])}
    store.commit((*staged[0], *staged[1]))
    top = root / "install" / "enclaves"
    assert files(root, temporary=True) == {
        *(f"install/enclaves/{name}/{file}" for name in ("robot", "other", "more") for file in ENCLAVE),
        "install/enclaves/g.xml",
        "install/enclaves/g.p7s",
    }
    new = ("g.xml", "g.p7s", "robot/key.pem", "robot/cert.pem", "other/cert.pem")
    assert {(top / name).read_bytes() for name in new} == {b"new"}


@pytest.mark.parametrize(
    ("space", "there", "named"),
    [("install", False, "install"), ("install", True, "install/enclaves"), ("private", False, "private/enclaves")],
)
def test_a_new_folder_in_which_several_processes_stage_appears_complete(
    root: Path, store: Store, space: str, there: bool, named: str
) -> None:
    top = root / space / "enclaves" / "site"
    if there:
        (root / space).mkdir(parents=True)
    both = [FolderChange(top / name, ENCLAVE) for name in ("robot", "other")]
    own = [FolderChange(top, {"g.xml": PUBLIC, "key.pem": SECRET}), FolderChange(root / space, {".gitignore": PUBLIC})]
    common = store.stage_common(str(each.folder) for each in both)
    assert [f"{each.folder}/{each.name}" for each in common] == [f"{root}/{named}"]
    other = Store({root: False, root / "install": False, root / "private": True}, root / ".keymint")
    other.common.update(store.common)
    staged = (*store.stage([*own, both[0]]), *other.stage(both[1:]))
    assert [each.name for each in staged] == ([] if named == space else [".gitignore"])
    assert files(root) == set()
    store.commit((*staged, *common))
    enclaves = {f"{space}/enclaves/site/{name}/{file}" for name in ("robot", "other") for file in ENCLAVE}
    beside = {f"{space}/.gitignore", *(f"{space}/enclaves/site/{name}" for name in own[0].files)}
    assert files(root, temporary=True) == enclaves | beside
    assert stat.S_IMODE(top.stat().st_mode) == 0o700
    assert stat.S_IMODE(top.parent.stat().st_mode) == (0o700 if space == "private" else 0o755)
    store.change([FolderChange(top / "robot", {"cert.pem": File(b"new")})])  # it is a folder like any other now
    assert (top / "robot" / "cert.pem").read_bytes() == b"new"


def test_nothing_is_left_of_a_new_folder_in_which_several_processes_staged(root: Path, store: Store) -> None:
    places = [str(root / "install" / "enclaves" / name) for name in ("robot", "other")]
    store.discard((*store.stage_common(places), *store.stage(changes(root, "robot"))))
    assert list(root.iterdir()) == []


def test_nothing_is_left_if_a_new_folder_for_several_processes_is_refused(root: Path, store: Store) -> None:
    (root / "build").mkdir(parents=True)
    (root / "build" / "a").symlink_to(root)
    places = [
        f"{root}/{name}" for name in ("install/enclaves/robot", "install/enclaves/other", "build/a/b/c", "build/a/b/d")
    ]
    with pytest.raises(KeymintError):
        store.stage_common(places)
    assert {each.name for each in root.iterdir()} == {"build"}


def test_files_of_a_folder_are_removed_while_another_process_changes_what_is_inside(root: Path, store: Store) -> None:
    store.change(changes(root, "robot", "robot/talker"))
    top = root / "install" / "enclaves" / "robot"
    inner = [
        FolderChange(top / "talker", {name: File(b"new") for name in ENCLAVE}),
        *changes(root, "robot/more"),
    ]
    staged = (*store.stage(inner), *store.stage([FolderChange(top, removed=tuple(ENCLAVE))]))
    inode = (top / "talker").stat().st_ino
    store.commit(staged)
    assert files(root, temporary=True) == {
        f"install/enclaves/robot/{name}/{file}" for name in ("talker", "more") for file in ENCLAVE
    }
    assert {(top / "talker" / name).read_bytes() for name in ENCLAVE} == {b"new"}
    assert (top / "talker").stat().st_ino != inode


def refuse(number: int) -> Any:
    def call(*_arguments: Any, **_options: Any) -> Any:
        raise OSError(number, os.strerror(number))

    return call


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("few", [True, False])
def test_if_synchronising_fails_nothing_becomes_visible(
    root: Path, store: Store, number: int, few: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.change(changes(root, "old"))
    before = files(root)
    if few:
        monkeypatch.setattr(os, "fsync", refuse(number))
    else:
        monkeypatch.setattr(group_commit, "FEW", -1)
        monkeypatch.setattr(file_writing, "_kind_of", lambda _: "ext4")
        monkeypatch.setattr(file_writing, "_syncfs", lambda: lambda _: set_error(number))
    with pytest.raises(KeymintError) as caught:
        store.change([FolderChange(root / "install" / "enclaves" / name, {"a": PUBLIC, "b": PUBLIC}) for name in "xy"])
    assert os.strerror(number) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert files(root, temporary=True) == before


def set_error(number: int) -> int:
    ctypes.set_errno(number)
    return -1


@pytest.fixture
def synchronised(root: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, frozenset[str]]]:
    """Each folder or file that is synchronised from now on, with the files that were visible then."""
    seen: list[tuple[str, frozenset[str]]] = []
    fsync = os.fsync

    def watched(opened: int) -> None:
        fsync(opened)
        path = Path(f"/proc/self/fd/{opened}").readlink()
        seen.append((str(path.relative_to(root.parent)), frozenset(files(root))))

    monkeypatch.setattr(os, "fsync", watched)
    return seen


def test_keys_are_durable_before_anything_else_appears(
    root: Path, store: Store, synchronised: list[tuple[str, frozenset[str]]]
) -> None:
    for folder in (root / "install", root / "private"):
        folder.mkdir(parents=True)
    store.change([*changes(root, "a"), FolderChange(root / "private", {"key.pem": SECRET})])
    states = list(dict.fromkeys(found for _, found in synchronised))
    enclave = {f"install/enclaves/a/{file}" for file in ENCLAVE}
    assert states == [frozenset(), {"private/key.pem"}, {"private/key.pem", *enclave}]
    assert ("ws/private", states[1]) in synchronised
    assert ("ws/install", states[2]) in synchronised


def test_the_first_private_file_is_durable_before_anything_else_appears(
    root: Path, store: Store, synchronised: list[tuple[str, frozenset[str]]]
) -> None:
    """It is the register: else a loss of power could leave a certificate without an entry."""
    (root / "private").mkdir(parents=True)
    store.change([FolderChange(root / "private", {"register.sqlite3": SECRET, "ca.key.pem": SECRET})])
    states = list(dict.fromkeys(found for _, found in synchronised))
    register = {"private/register.sqlite3"}
    assert states == [frozenset(), register, {*register, "private/ca.key.pem"}]
    assert ("ws/private", states[1]) in synchronised


def test_folders_that_may_be_new_are_synchronised_with_those_around_them_and_once(
    store: Store, root: Path, synchronised: list[tuple[str, frozenset[str]]]
) -> None:
    found = []
    for name in ("a", "b", "c"):
        store.change(changes(root, name))
        found.append([path for path, _ in synchronised if ".keymint-" not in path])
        synchronised.clear()
    enclaves = "ws/install/enclaves"
    assert found == [["ws", "ws/install"], ["ws/install", enclaves], [enclaves]]


def test_a_file_that_someone_adds_to_a_removed_folder_stays(
    root: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.change(changes(root, "a", "a/inner"))
    top = root / "install" / "enclaves" / "a"
    staged = store.stage([FolderChange(top / name, {}, tuple(ENCLAVE)) for name in ("", "inner")])
    (top / "inner" / "late.pem").write_bytes(b"late")
    store.commit(staged)
    assert files(root, temporary=True) == {"install/enclaves/a/inner/late.pem"}
    assert {path.name for path in (root / "install" / "enclaves").iterdir()} == {"a"}


NAMES = st.sampled_from(["a", "b", "a/b", "a/b/c", "d"])


@settings(max_examples=tries(20, 40))
@given(before=st.sets(NAMES), written=st.sets(NAMES), split=st.booleans())
def test_one_group_or_several_lead_to_the_same_files(
    tmp_path_factory: pytest.TempPathFactory, before: set[str], written: set[str], split: bool
) -> None:
    root = tmp_path_factory.mktemp("group") / "ws"
    store = Store({root: False}, root / ".keymint")
    store.change(changes(root, *sorted(before)))
    listed = changes(root, *sorted(written))
    groups: Iterable[list[FolderChange]] = [listed]
    if split:
        # Members below one top namespace stay together.
        tops = sorted({name.split("/")[0] for name in written})
        groups = [changes(root, *(name for name in sorted(written) if name.split("/")[0] == top)) for top in tops]
    store.commit([exchange for group in groups for exchange in store.stage(group)])
    expected = {f"install/enclaves/{name}/{file}" for name in before | written for file in ENCLAVE}
    assert files(root, temporary=True) == expected
