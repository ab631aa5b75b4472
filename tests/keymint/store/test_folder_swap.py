# SPDX-License-Identifier: Apache-2.0
"""A folder changes as a whole: no path shows a mix, whatever is nested, and nothing is lost at a kill."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import shutil
import stat
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from keymint.errors import KeymintError
from keymint.store import group_commit
from keymint.store.changes import File, FolderChange
from keymint.store.journal import Journal
from keymint.store.staged import Exchange
from keymint.store.store import Store

Folders = dict[str, dict[str, bytes]]
"""Files by name of each folder, by its path."""


def store_at(root: Path) -> Store:
    return Store({root: False, root / "install": False}, root / ".keymint")


def remove(root: Path, folder: Path, names: list[str]) -> None:
    store_at(root).change([FolderChange(folder, removed=tuple(names))])


def visible(top: Path) -> Folders:
    """Return what each folder shows; temporary folders are none of it, wherever they are."""
    found: Folders = {}
    for folder, folders, files in os.walk(top):
        folders[:] = [name for name in folders if not name.startswith(".keymint-")]
        shown = [name for name in files if not name.startswith(".keymint-")]
        if shown:
            contents = {name: _content(Path(folder) / name) for name in shown}
            found[str(Path(folder).relative_to(top))] = contents
    return found


def _content(path: Path) -> bytes:
    return b"-> " + os.fsencode(path.readlink()) if path.is_symlink() else path.read_bytes()


def write_down(top: Path, folders: Folders) -> None:
    for path, files in folders.items():
        (top / path).mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            (top / path / name).write_bytes(content)


def left_behind(root: Path) -> list[str]:
    return [str(path) for path in root.rglob(".keymint-*")]


# -- how a process dies ------------------------------------------------------------------------------------------

MUTATORS = ("mkdir", "rename", "link", "symlink", "unlink", "rmdir", "fsync", "fchmod", "write")


class KilledError(BaseException):
    """The process is no more: nothing that it would do after this is done."""


class Watched:
    """Counts the calls that change a file system, looks after each, and kills at one of them.

    Args:
        kill: the number of the call that is the last one.
        look: called after each call.
        refused: what an exchange of names is refused with, or 0.
    """

    def __init__(self, kill: int = -1, look: Callable[[], None] = lambda: None, refused: int = 0) -> None:
        self.count = 0
        self._kill = kill
        self._look = look
        self._refused = refused
        self.stuck: set[int] = set()
        """Inodes of folders that cannot be renamed (``EXDEV``), as those of a lower layer of overlayfs."""

    @contextlib.contextmanager
    def patched(self) -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            for name in MUTATORS:
                patch.setattr(os, name, self._wrapped(getattr(os, name)))
            patch.setattr(group_commit, "exchange_names", self._wrapped(self._exchange(group_commit.exchange_names)))
            patch.setattr(os, "rename", self._rename(os.rename))
            yield

    def _wrapped(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if self.count == self._kill:
                raise KilledError
            self.count += 1
            result = real(*arguments, **options)
            self._look()
            return result

        return call

    def _exchange(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            if self._refused:
                raise OSError(self._refused, os.strerror(self._refused))
            return real(*arguments)

        return call

    def _rename(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(source: str, target: str, **options: Any) -> Any:
            if os.stat(source, dir_fd=options.get("src_dir_fd"), follow_symlinks=False).st_ino in self.stuck:
                raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
            return real(source, target, **options)

        return call


# -- the law -----------------------------------------------------------------------------------------------------

SEGMENTS = st.sampled_from(["a", "b"])
PATHS = st.lists(SEGMENTS, max_size=3).map("/".join).map(lambda path: f"enclaves/{path}".rstrip("/"))
NAMES = st.sampled_from(["cert.pem", "key.pem", "p.xml", "p.p7s"])
OLD = st.dictionaries(PATHS, st.dictionaries(NAMES, st.just(b"old"), min_size=1), max_size=5)
EDITS = st.dictionaries(
    PATHS,
    st.tuples(st.dictionaries(NAMES, st.just(b"new")), st.sets(NAMES)),
    min_size=1,
    max_size=4,
)


def changes_of(top: Path, edits: Mapping[str, tuple[Mapping[str, bytes], set[str]]]) -> list[FolderChange]:
    return [
        FolderChange(
            top / path,
            {name: File(content, secret=name == "key.pem") for name, content in files.items()},
            tuple(sorted(removed - set(files))),
        )
        for path, (files, removed) in edits.items()
    ]


def changed(old: Folders, edits: Mapping[str, tuple[Mapping[str, bytes], set[str]]]) -> Folders:
    new = {path: dict(files) for path, files in old.items()}
    for path, (files, removed) in edits.items():
        kept = {name: content for name, content in new.get(path, {}).items() if name not in removed}
        new[path] = {**kept, **files}
    return {path: files for path, files in new.items() if files}


@pytest.mark.parametrize("refused", [0, errno.EINVAL, errno.EXDEV])
@settings(max_examples=25)
@given(old=OLD, edits=EDITS, data=st.data())
def test_every_folder_is_wholly_old_or_wholly_new_and_a_kill_loses_nothing(
    refused: int, old: Folders, edits: Mapping[str, tuple[dict[str, bytes], set[str]]], data: st.DataObject
) -> None:
    for files in old.values():
        files["README"] = b"a user's"
    new = changed(old, edits)
    with tempfile.TemporaryDirectory(dir=_memory()) as name:
        kill = -1
        for _ in range(2):
            root = Path(name) / f"run{kill}"
            top = root / "install"
            write_down(top, old)
            watched = Watched(kill, lambda top=top: require_no_mix(visible(top), old, new, refused), refused)
            if refused == errno.EXDEV:
                watched.stuck = {(top / path).stat().st_ino for path in old}
            store = store_at(root)
            store.begin(Journal())
            with contextlib.suppress(KilledError), watched.patched():
                store.commit(store.stage(changes_of(top, edits)))
                store.end()
            if kill == -1:
                assert visible(top) == new
                assert left_behind(root) == []
                kill = data.draw(st.integers(0, max(0, watched.count - 1)), label="kill")
                continue
            again = store_at(root)
            again.recover()
            assert visible(top) in (old, new)
            assert left_behind(root) == []
            again.change(changes_of(top, edits))
            assert visible(top) == new


def require_no_mix(found: Folders, old: Folders, new: Folders, refused: int) -> None:
    for path in {*old, *new}:
        files, before, after = found.get(path, {}), old.get(path, {}), new.get(path, {})
        if files in (before, after):
            continue
        # Where names cannot be exchanged, a folder may be away for a moment, or go file by file; it is never mixed.
        assert refused, (path, files)
        assert all(before.get(name) == content for name, content in files.items()), (path, files)


def _memory() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


# -- what lies in the folder -------------------------------------------------------------------------------------


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "ws"


def test_a_file_in_the_place_of_a_subfolder_is_refused(root: Path) -> None:
    folder, store = root / "install" / "robot", store_at(root)
    store.write(folder, {"cert.pem": File(b"old"), "talker": File(b"a user's")})
    with pytest.raises(KeymintError, match="File exists"):
        store.change([FolderChange(folder, NEW), FolderChange(folder / "talker", NEW)])
    assert visible(root / "install") == {"robot": {"cert.pem": b"old", "talker": b"a user's"}}


@pytest.fixture
def enclave(root: Path) -> Path:
    """Return the folder of an enclave with another one inside, and with what is not Keymint's in both."""
    folder = root / "install" / "robot"
    store = store_at(root)
    store.write(folder, {"key.pem": File(b"old", secret=True), "cert.pem": File(b"old")})
    store.write(folder / "talker", {"key.pem": File(b"inner", secret=True), "cert.pem": File(b"inner")})
    for place in (folder, folder / "talker"):
        (place / "crl.pem").write_bytes(b"a user's")
        (place / "crl.pem").chmod(0o640)
        (place / "link").symlink_to("crl.pem")
    (folder / "notes" / "deep").mkdir(parents=True)
    (folder / "notes" / "deep" / "README").write_bytes(b"a user's")
    os.mkfifo(folder / "fifo")
    return folder


NEW = {"key.pem": File(b"new", secret=True), "cert.pem": File(b"new"), "more.pem": File(b"new")}


def status(folder: Path) -> dict[str, tuple[int, int, int, int]]:
    return {
        str(path.relative_to(folder)): (
            path.lstat().st_ino if not path.is_dir() or path.is_symlink() else 0,
            path.lstat().st_mode,
            path.lstat().st_uid,
            path.lstat().st_gid,
        )
        for path in (folder, *folder.rglob("*"))
    }


def test_what_is_not_ours_stays_the_same_file(root: Path, enclave: Path) -> None:
    before = status(enclave)
    store_at(root).write(enclave, NEW)
    after = status(enclave)
    assert {name: after[name] for name in before if name not in NEW} == {
        name: value for name, value in before.items() if name not in NEW
    }
    assert set(after) == {*before, "more.pem"}
    assert all(path.lstat().st_nlink == 1 for path in enclave.rglob("*") if not path.is_dir())
    assert left_behind(root) == []


def test_a_folder_keeps_its_mode_and_its_attributes(root: Path, enclave: Path) -> None:
    (enclave / "notes").chmod(0o2750)
    with contextlib.suppress(OSError):
        os.setxattr(enclave / "notes", "user.keymint", b"x")
    names = os.listxattr(enclave / "notes")
    store_at(root).write(enclave, NEW)
    assert stat.S_IMODE((enclave / "notes").stat().st_mode) == 0o2750
    assert stat.S_IMODE(enclave.stat().st_mode) == 0o700
    assert os.listxattr(enclave / "notes") == names


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_run_by_root_what_belongs_to_a_robot_stays_its_own(root: Path, enclave: Path) -> None:
    for path in (enclave, enclave / "key.pem", enclave / "talker", enclave / "talker" / "key.pem"):
        os.chown(path, 1234, 4321)
    store_at(root).write(enclave, NEW)
    store_at(root).write(enclave / "talker", {"key.pem": File(b"one alone", secret=True)})
    for path in (enclave, enclave / "key.pem", enclave / "more.pem", enclave / "talker", enclave / "talker/key.pem"):
        assert (path.stat().st_uid, path.stat().st_gid) == (1234, 4321), path
    assert (enclave / "cert.pem").stat().st_uid == 0


def test_an_enclave_goes_at_once_and_the_one_inside_stays(root: Path, enclave: Path) -> None:
    inside = status(enclave / "talker")
    states = set()

    def look() -> None:
        states.add(frozenset(path.name for path in enclave.iterdir()))

    watched = Watched(look=look)
    with watched.patched():
        remove(root, enclave, ["key.pem", "cert.pem", "crl.pem", "link", "fifo"])
    whole = frozenset({"key.pem", "cert.pem", "crl.pem", "link", "fifo", "talker", "notes"})
    assert states == {whole, frozenset({"talker", "notes"})}
    assert status(enclave / "talker") == inside


def test_folders_that_change_together_change_in_one_exchange(root: Path, enclave: Path) -> None:
    for name in ("a", "b", "c/d"):
        store_at(root).write(enclave / name, NEW)
    count = []
    real = group_commit.exchange_names
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(group_commit, "exchange_names", lambda *arguments: (count.append(arguments), real(*arguments)))
        names = ("c/d", "", "a", "b", "talker")
        store_at(root).change([FolderChange(enclave / name, NEW) for name in names])
    assert len(count) == 1
    assert all((enclave / name / "key.pem").read_bytes() == b"new" for name in names)


def test_a_single_file_is_replaced_where_it_is(root: Path, enclave: Path) -> None:
    before = enclave.stat().st_ino
    store_at(root).write(enclave, {"cert.pem": File(b"new")})
    remove(root, enclave, ["key.pem"])
    assert enclave.stat().st_ino == before


def test_what_somebody_adds_at_the_last_moment_is_not_lost(root: Path, enclave: Path) -> None:
    real = group_commit.exchange_names

    def late(*arguments: Any) -> None:
        (enclave / "late.pem").write_bytes(b"late")
        (enclave / "talker" / "late").mkdir()
        (enclave / "talker" / "late" / "x").write_bytes(b"late")
        (enclave / "talker" / "other").write_bytes(b"replaced late")
        (enclave / "talker" / "other").rename(enclave / "talker" / "crl.pem")
        real(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(group_commit, "exchange_names", late)
        store_at(root).write(enclave, NEW)
    assert (enclave / "late.pem").read_bytes() == b"late"
    assert (enclave / "talker" / "late" / "x").read_bytes() == b"late"
    assert (enclave / "talker" / "crl.pem").read_bytes() == b"replaced late"
    assert left_behind(root) == []


@pytest.mark.parametrize("refused", [errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP])
def test_without_hard_links_files_are_copied_with_all_that_they_have(root: Path, enclave: Path, refused: int) -> None:
    (enclave / "fifo").unlink()
    os.utime(enclave / "crl.pem", ns=(5, 7))
    before = {name: value[1:] for name, value in status(enclave).items()}

    def refuse(*_arguments: Any, **_options: Any) -> None:
        raise OSError(refused, os.strerror(refused))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "link", refuse)
        store_at(root).write(enclave, NEW)
    after = {name: value[1:] for name, value in status(enclave).items()}
    assert {name: after[name] for name in before} == before
    assert (enclave / "talker" / "crl.pem").read_bytes() == b"a user's"
    assert (enclave / "link").readlink() == Path("crl.pem")
    assert (enclave / "crl.pem").stat().st_mtime_ns == 7
    assert left_behind(root) == []


def test_a_link_or_a_fifo_is_not_replaced_and_nothing_changes(root: Path, enclave: Path) -> None:
    before = visible_but_fifo(enclave)
    for name in ("link", "fifo", "talker"):
        with pytest.raises(KeymintError, match="is not replaced"):
            store_at(root).write(enclave, {"cert.pem": File(b"new"), name: File(b"new")})
        assert visible_but_fifo(enclave) == before
    assert left_behind(root) == []


def visible_but_fifo(folder: Path) -> list[str]:
    return sorted(
        f"{path} {path.read_bytes()!r}" for path in folder.rglob("*") if path.is_file() and not path.is_symlink()
    )


# -- real file systems -------------------------------------------------------------------------------------------


@contextlib.contextmanager
def mounted(kind: str, at: Path, *options: str) -> Iterator[Path]:
    """Mount a file system, or skip where the machine does not let us."""
    at.mkdir(parents=True, exist_ok=True)
    ran = subprocess.run(["mount", "-t", kind, kind, *options, at], capture_output=True, text=True, check=False)
    if ran.returncode:
        pytest.skip(f"cannot mount {kind}: {ran.stderr.strip()}")
    try:
        yield at
    finally:
        subprocess.run(["umount", at], check=True)


@pytest.fixture
def overlay(tmp_path: Path) -> Iterator[Path]:
    """Return a root on overlayfs whose enclaves lie in the lower layer, as those that an image came with."""
    lower = tmp_path / "lower" / "install"
    write_down(lower, {"robot": {"key.pem": b"old", "cert.pem": b"old", "crl.pem": b"a user's"}})
    write_down(lower, {"robot/talker": {"key.pem": b"inner", "cert.pem": b"inner"}, "other": {"cert.pem": b"other"}})
    for name in ("upper", "work"):
        (tmp_path / name).mkdir()
    layers = f"lowerdir={lower.parent},upperdir={tmp_path}/upper,workdir={tmp_path}/work"
    with mounted("overlay", tmp_path / "merged", "-o", layers) as merged:
        yield merged


def test_on_overlayfs_a_folder_of_a_lower_layer_is_replaced_and_removed(overlay: Path) -> None:
    enclave = overlay / "install" / "robot"
    with pytest.raises(OSError, match="cross-device"):
        enclave.rename(overlay / "install" / "renamed")  # else this tests nothing
    store = store_at(overlay)
    old = visible(overlay / "install")
    new = {**old, "robot": {name: file.content for name, file in NEW.items()} | {"crl.pem": b"a user's"}}
    watched = Watched(look=lambda: require_no_mix(visible(overlay / "install"), old, new, errno.EXDEV))
    with watched.patched():
        store.write(enclave, NEW)
    assert visible(overlay / "install") == new
    store.write(enclave, NEW)  # now it lies in the upper layer
    store.change([FolderChange(overlay / "install" / "other", removed=("cert.pem",))])
    store.change([FolderChange(enclave, removed=tuple(new["robot"])), FolderChange(enclave / "talker", NEW)])
    assert visible(overlay / "install") == {"robot/talker": {name: file.content for name, file in NEW.items()}}
    assert left_behind(overlay) == []


@pytest.mark.parametrize("at", range(0, 40, 3))
def test_on_overlayfs_a_kill_loses_nothing(overlay: Path, at: int) -> None:
    store = store_at(overlay)
    old = visible(overlay / "install")
    new = {**old, "robot": {name: file.content for name, file in NEW.items()} | {"crl.pem": b"a user's"}}
    store.begin(Journal())
    with contextlib.suppress(KilledError), Watched(at).patched():
        store.commit(store.stage([FolderChange(overlay / "install" / "robot", NEW)]))
    store_at(overlay).recover()
    assert visible(overlay / "install") in (old, new)
    assert left_behind(overlay) == []


def test_a_mount_inside_is_refused_and_nothing_of_it_is_touched(root: Path, enclave: Path, tmp_path: Path) -> None:
    inside = enclave / "notes" / "deep"
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "file").write_bytes(b"untouched")
    (tmp_path / "empty").mkdir()
    for mount in (
        ["-t", "tmpfs", "tmpfs"], ["--bind", tmp_path / "elsewhere"], ["--bind", tmp_path / "empty"],
    ):  # fmt: skip
        before = visible_but_fifo(enclave)
        ran = subprocess.run(["mount", *mount, inside], capture_output=True, check=False)
        if ran.returncode:
            pytest.skip("cannot mount")
        try:
            with pytest.raises(KeymintError, match="is a mount point") as caught:
                store_at(root).write(enclave, NEW)
            assert len(str(caught.value).splitlines()) == 1
        finally:
            subprocess.run(["umount", inside], check=True)
        assert visible_but_fifo(enclave) == before
        assert left_behind(root) == []
    assert (tmp_path / "elsewhere" / "file").read_bytes() == b"untouched"


def test_an_enclave_that_is_a_mount_point_is_refused_with_what_to_do(root: Path, enclave: Path) -> None:
    ran = subprocess.run(["mount", "--bind", enclave, enclave], capture_output=True, check=False)
    if ran.returncode:
        pytest.skip("cannot mount")
    try:
        with pytest.raises(KeymintError, match="mount the folder above"):
            store_at(root).write(enclave, NEW)
    finally:
        subprocess.run(["umount", enclave], check=True)
    assert (enclave / "key.pem").read_bytes() == b"old"
    assert left_behind(root) == []


# -- who reads meanwhile -----------------------------------------------------------------------------------------


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(dir=_memory() or tmp_path) as folder:
        yield Path(folder)


def test_who_reads_by_an_open_folder_never_sees_a_mix(memory: Path) -> None:
    root = memory / "ws"
    folder = root / "install" / "robot"
    store = store_at(root)
    names = [f"{number}.pem" for number in range(6)]

    def content(version: int) -> dict[str, File]:
        return {name: File(b"%d" % version) for name in names}

    store.write(folder, content(0))
    store.write(folder / "talker", content(0))
    seen: set[bytes] = set()
    mixed: list[set[bytes]] = []
    done = threading.Event()

    def read(place: Path) -> None:
        while not done.is_set():
            opened = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
            try:
                found = set()
                for name in names:
                    file = os.open(name, os.O_RDONLY, dir_fd=opened)
                    found.add(os.read(file, 99))
                    os.close(file)
            except FileNotFoundError:
                continue  # the folder was replaced, and is being removed
            finally:
                os.close(opened)
            seen.update(found)
            if len(found) != 1:
                mixed.append(found)

    readers = [threading.Thread(target=read, args=(place,)) for place in (folder, folder / "talker")]
    for reader in readers:
        reader.start()
    for version in range(1, 200):
        store.change([FolderChange(folder, content(version)), FolderChange(folder / "talker", content(version))])
    done.set()
    for reader in readers:
        reader.join()
    assert mixed == []
    assert len(seen) > 20


def test_the_library_has_the_call(tmp_path: Path) -> None:
    # Elsewhere than on Linux with a recent C library the slower way is taken; here that would hide a mistake.
    assert hasattr(ctypes.CDLL(None), "renameat2")
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).touch()
    opened = os.open(tmp_path, os.O_RDONLY | os.O_DIRECTORY)
    group_commit.exchange_names(opened, "a", "b")
    os.close(opened)
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]
    shutil.rmtree(tmp_path / "a")


def test_folders_are_written_in_their_order_but_new_ones_before_those_inside(root: Path) -> None:
    order: list[str] = []
    store = store_at(root)
    top = root / "install"
    names = ("z", "new/inner", "new", "", "a")

    def look() -> None:
        found = {path for path, files in visible(top).items() if files}
        order.extend(sorted(found - set(order)))

    with Watched(look=look).patched():
        store.change([FolderChange(top / name, NEW) for name in names])
    # The root comes when its turn is: whoever names it last means it to be the last.
    assert order == ["z", "new", "new/inner", ".", "a"]


@pytest.mark.parametrize("refused", [0, errno.EINVAL])
def test_a_kill_loses_nothing_of_what_processes_staged_inside_of_each_other(tmp_path: Path, refused: int) -> None:
    old = {"": {"a": b"old", "b": b"old"}, "robot": {"a": b"old", "b": b"old", "own": b"own"}, "robot/in": {"a": b""}}
    new = {
        "": {"a": b"new", "b": b"new"},
        "robot": {"a": b"new", "b": b"new", "own": b"own"},
        "robot/in": {"a": b"new"},
    }

    def staged(store: Store, top: Path) -> list[Exchange]:
        edits = (("", ("a", "b")), ("robot", ("a", "b")), ("robot/in", ("a",)))
        changes = (FolderChange(top / path, {name: File(b"new") for name in names}) for path, names in edits)
        return [exchange for change in changes for exchange in store.stage([change])]

    seen = set()
    for kill in range(200):
        root = tmp_path / str(kill)
        top = root / "install" / "enclaves"
        write_down(top, old)
        store = store_at(root)
        store.begin(Journal())
        made = staged(store, top)
        watched = Watched(kill, refused=refused)
        with contextlib.suppress(KilledError), watched.patched():
            store.commit(made)
            break
        store_at(root).recover()
        seen.add(found := visible(top) == {path or ".": files for path, files in new.items()})
        assert found or visible(top) == {path or ".": files for path, files in old.items()}
        assert left_behind(root) == []
    assert seen == {False, True}
