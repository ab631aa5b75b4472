# SPDX-License-Identifier: Apache-2.0
"""The only writer: confinement, modes, whole or not at all, the lock, and what the system refuses."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import stat
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from keymint.errors import KeymintError
from keymint.store.changes import File, FolderChange
from keymint.store.file_writing import MAX_COMPONENT
from keymint.store.journal import Journal
from keymint.store.store import Store
from keymint.view.recorded_answers import folder_status

PUBLIC = File(b"public")
SECRET = File(b"secret", secret=True)


def listing(folder: Path) -> dict[str, str]:
    """Return every path below a folder with what it is: its mode, and a file's bytes."""
    found = {}
    for path in sorted(folder.rglob("*")):
        mode = f"{stat.S_IMODE(path.lstat().st_mode):04o}"
        if path.is_symlink():
            found[str(path.relative_to(folder))] = "link"
        else:
            found[str(path.relative_to(folder))] = f"{mode} {path.read_bytes()!r}" if path.is_file() else mode
    return found


def remove(store: Store, folder: Path, names: list[str]) -> None:
    store.change([FolderChange(folder, removed=tuple(names))])


def names(folder: Path) -> frozenset[str]:
    """Return the names of what lies in a folder."""
    return frozenset(path.name for path in folder.iterdir())


def one_line(error: KeymintError) -> str:
    """Return the message of an error, which must be one line."""
    [line] = str(error).splitlines()
    return line


def code_of(action: Callable[..., object], *arguments: Any) -> str:
    with pytest.raises(KeymintError) as caught:
        action(*arguments)
    assert len(str(caught.value).splitlines()) == 1
    return caught.value.diagnostics[0].code


@contextlib.contextmanager
def umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


# -- what is written ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o027, 0o077, 0o777])
def test_modes_do_not_depend_on_the_umask(root: Path, store: Store, mask: int) -> None:
    with umask(mask):
        store.write(root / "install" / "a" / "b", {"key.pem": SECRET, "cert.pem": PUBLIC})
        store.write(root / "install" / "a" / "b", {"more.pem": SECRET, "cert.pem": File(b"new")})
        store.write(root / "install" / "plain" / "deep", {"file": PUBLIC})
        store.write(root / "private" / "x" / "y", {"key.pem": SECRET})
        store.write(root / "private" / "z", {"file": PUBLIC})
        store.change([FolderChange(root / "src" / "p", {"file": PUBLIC}, private=True)])
    assert listing(root) == {
        "install": "0755",
        "install/a": "0755",
        "install/a/b": "0700",
        "install/a/b/cert.pem": "0644 b'new'",
        "install/a/b/key.pem": "0600 b'secret'",
        "install/a/b/more.pem": "0600 b'secret'",
        "install/plain": "0755",
        "install/plain/deep": "0755",
        "install/plain/deep/file": "0644 b'public'",
        "private": "0700",
        "private/x": "0700",
        "private/x/y": "0700",
        "private/x/y/key.pem": "0600 b'secret'",
        "private/z": "0700",
        "private/z/file": "0644 b'public'",
        "src": "0755",
        "src/p": "0700",
        "src/p/file": "0644 b'public'",
    }


def test_a_secret_closes_a_folder_that_stood_open(root: Path, store: Store) -> None:
    store.write(root / "install" / "a", {"file": PUBLIC})
    store.write(root / "install" / "a", {"key.pem": SECRET})
    assert stat.S_IMODE((root / "install" / "a").stat().st_mode) == 0o700


def test_a_secret_is_0600_from_its_first_byte(root: Path, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    write = os.write

    def watched(descriptor: int, data: bytes) -> int:
        seen.append(stat.S_IMODE(os.fstat(descriptor).st_mode))
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", watched)
    with umask(0):
        store.write(root / "install" / "a", {"key.pem": SECRET})
        store.write(root / "install" / "a", {"key.pem": File(b"renewed", secret=True)})
    assert seen == [0o600, 0o600]


def test_a_mode_that_was_changed_is_set_right_with_the_content(root: Path, store: Store) -> None:
    store.write(root / "install" / "a", {"key.pem": SECRET})
    (root / "install" / "a" / "key.pem").chmod(0o666)
    store.write(root / "install" / "a", {"key.pem": SECRET})
    assert stat.S_IMODE((root / "install" / "a" / "key.pem").stat().st_mode) == 0o600


def test_a_large_file_is_written_in_whatever_pieces_the_system_takes(
    root: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:7]))
    content = bytes(range(256)) * 3
    store.write(root, {"file": File(content)})
    assert (root / "file").read_bytes() == content


def test_nothing_to_write_makes_no_folder(root: Path, store: Store) -> None:
    store.write(root / "install" / "a", {})
    assert not root.exists()


def test_a_file_is_replaced_not_overwritten(root: Path, store: Store) -> None:
    store.write(root, {"file": File(b"old")})
    with (root / "file").open("rb") as reader:
        store.write(root, {"file": File(b"new")})
        assert reader.read() == b"old"  # who has it open reads on in the old one
    assert (root / "file").read_bytes() == b"new"


def test_a_hard_link_elsewhere_is_not_written_through(root: Path, store: Store, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_bytes(b"untouched")
    root.mkdir()
    os.link(outside, root / "file")
    store.write(root, {"file": File(b"new")})
    assert outside.read_bytes() == b"untouched"


def test_a_new_folder_appears_whole(root: Path, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = root / "install" / "a"
    states = set()
    for call in ("open", "write", "fsync", "fchmod", "rename", "mkdir", "close"):
        real = getattr(os, call)

        def watched(*arguments: Any, _real: Any = real, **options: Any) -> Any:
            result = _real(*arguments, **options)
            states.add(names(folder) if folder.exists() else None)
            return result

        monkeypatch.setattr(os, call, watched)
    store.write(folder, {"one": PUBLIC, "two": SECRET, "three": PUBLIC})
    assert states == {None, frozenset({"one", "two", "three"})}


# -- confinement -------------------------------------------------------------------------------------------------


def test_what_lies_outside_is_refused(root: Path, store: Store, tmp_path: Path) -> None:
    inside = root / "install"
    for folder in (
        tmp_path,
        tmp_path / "other",
        Path("/etc"),
        Path("relative"),
        inside / "..",
        inside / ".." / ".." / "other",
        inside / "a" / ".." / "b",
        root.with_name("ws-not-this-one"),
    ):
        assert code_of(store.write, folder, {"file": PUBLIC}) == "confined", folder
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_bytes(b"")
    assert code_of(remove, store, tmp_path, ["file"]) == "confined"
    assert (tmp_path / "file").exists()


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/b", "/etc/passwd", "../x", "a\0b", "x" * (MAX_COMPONENT + 1), "ä" * MAX_COMPONENT]
)
def test_what_is_no_name_of_a_file_is_refused(root: Path, store: Store, name: str) -> None:
    assert code_of(store.write, root / "install" / "a", {"good": PUBLIC, name: PUBLIC}) == "confined"
    assert not root.exists()
    store.write(root / "install" / "a", {"good": PUBLIC})
    assert code_of(remove, store, root / "install" / "a", ["good", name]) == "confined"
    assert (root / "install" / "a" / "good").exists()


@pytest.mark.parametrize("part", ["a\0b", "x" * (MAX_COMPONENT + 1)])
def test_what_is_no_name_of_a_folder_is_refused(root: Path, store: Store, part: str) -> None:
    assert code_of(store.write, root / "install" / part, {"file": PUBLIC}) == "confined"
    assert code_of(store.write, root / "install" / part / "deep", {"file": PUBLIC}) == "confined"


def test_the_longest_name_is_written_and_replaced(root: Path, store: Store) -> None:
    name = "x" * MAX_COMPONENT
    for content in (b"old", b"new"):
        store.write(root / name / name, {name: File(content)})
        assert (root / name / name / name).read_bytes() == content


def test_a_path_that_is_longer_than_the_system_takes_at_once(root: Path, store: Store) -> None:
    folder = root.joinpath(*["x" * 200] * 30)
    with contextlib.suppress(KeymintError):  # either is fine, but nothing else may be raised
        store.write(folder, {"file": PUBLIC})


@pytest.mark.parametrize("target", ["elsewhere", "missing"])
@pytest.mark.parametrize("place", ["ws/install/a/file", "ws/install/a", "ws/install/a/b", "ws/install"])
def test_a_planted_link_is_refused_wherever_it_stands(tmp_path: Path, store: Store, place: str, target: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "file").write_bytes(b"untouched")
    link = tmp_path / place
    link.parent.mkdir(parents=True, exist_ok=True)
    file = place.endswith("file")
    link.symlink_to(tmp_path / target / "file" if file else tmp_path / target)
    folder = tmp_path / "ws" / "install" / "a" if file else tmp_path / "ws" / "install" / "a" / "b" / "c"
    before = listing(tmp_path)
    assert code_of(store.write, folder, {"file": PUBLIC}) == "symlink-refused"
    assert listing(tmp_path) == before


def test_a_root_that_became_a_link_is_refused(tmp_path: Path, root: Path, store: Store) -> None:
    (tmp_path / "elsewhere").mkdir()
    root.symlink_to(tmp_path / "elsewhere")
    assert code_of(store.write, root / "src" / "a", {"file": PUBLIC}) == "symlink-refused"
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.parametrize("place", ["install/a/b", "install/a", "install"])
def test_a_planted_link_is_not_removed_through(tmp_path: Path, root: Path, store: Store, place: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "a" / "b").mkdir(parents=True)
    (elsewhere / "b").mkdir()
    for folder in (elsewhere / "a" / "b", elsewhere / "b", elsewhere):
        (folder / "file").write_bytes(b"untouched")
    (root / place).parent.mkdir(parents=True)
    (root / place).symlink_to(elsewhere)
    before = listing(tmp_path)
    assert code_of(remove, store, root / "install" / "a" / "b", ["file"]) == "symlink-refused"
    assert listing(tmp_path) == before


def test_a_link_as_the_folder_of_records_or_as_the_lock_is_refused(tmp_path: Path, root: Path, store: Store) -> None:
    (tmp_path / "elsewhere").mkdir()
    root.mkdir()
    (root / ".keymint").symlink_to(tmp_path / "elsewhere")
    assert code_of(lambda: store.locked(lambda _: None).__enter__()) == "symlink-refused"
    (root / ".keymint").unlink()
    (root / ".keymint").mkdir()
    (root / ".keymint" / "lock").symlink_to(tmp_path / "victim")
    assert code_of(lambda: store.locked(lambda _: None).__enter__()) == "symlink-refused"
    assert list((tmp_path / "elsewhere").iterdir()) == []
    assert not (tmp_path / "victim").exists()


def test_what_is_no_regular_file_is_not_replaced(root: Path, store: Store) -> None:
    (root / "folder").mkdir(parents=True)
    os.mkfifo(root / "fifo")
    for name in ("folder", "fifo"):
        assert code_of(store.write, root, {name: PUBLIC}) == "symlink-refused"
    (root / "file").write_bytes(b"")
    assert code_of(store.write, root / "file" / "below", {"x": PUBLIC}) == "write-failed"


# -- removal -----------------------------------------------------------------------------------------------------


def test_a_removed_folder_takes_its_empty_parents_along(root: Path, store: Store) -> None:
    store.write(root / "install" / "a" / "b" / "c", {"one": PUBLIC, "two": SECRET})
    remove(store, root / "install" / "a" / "b" / "c", ["one", "two"])
    assert listing(root) == {"install": "0755"}


def test_what_is_not_named_stays(root: Path, store: Store) -> None:
    store.write(root / "install" / "a", {"one": PUBLIC, "two": PUBLIC})
    store.write(root / "install" / "a" / "b", {"one": PUBLIC})
    remove(store, root / "install" / "a", ["one", "missing"])
    assert set(listing(root / "install")) == {"a", "a/two", "a/b", "a/b/one"}
    remove(store, root / "install" / "a", ["two"])
    assert set(listing(root / "install")) == {"a", "a/b", "a/b/one"}
    remove(store, root / "install" / "a" / "b", ["one"])
    assert listing(root / "install") == {}


def test_a_whole_folder_vanishes_at_once(root: Path, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = root / "install" / "a" / "b"
    store.write(folder, {"one": PUBLIC, "two": SECRET})
    states = {names(folder)}
    for call in ("unlink", "rmdir", "rename", "fsync"):
        real = getattr(os, call)

        def watched(*arguments: Any, _real: Any = real, **options: Any) -> Any:
            result = _real(*arguments, **options)
            states.add(names(folder) if (root / "install" / "a").exists() else None)
            return result

        monkeypatch.setattr(os, call, watched)
    remove(store, folder, ["one", "two"])
    assert states == {None, frozenset({"one", "two"})}
    assert listing(root / "install") == {}


def test_removing_what_is_not_there_does_nothing(root: Path, store: Store) -> None:
    remove(store, root / "install" / "a", ["one"])
    assert not root.exists()


def test_a_root_stays_when_its_last_file_goes(root: Path, store: Store) -> None:
    store.write(root / "install", {"one": PUBLIC})
    remove(store, root / "install", ["one"])
    assert listing(root) == {"install": "0755"}


# -- what the system refuses -------------------------------------------------------------------------------------

CALLS = ("open", "write", "fsync", "fchmod", "rename", "mkdir")


def prepared(store: Store, root: Path) -> None:
    store.write(root / "install" / "old", {"one": File(b"old"), "two": File(b"old", secret=True)})


def everything(store: Store, root: Path) -> None:
    store.write(root / "install" / "old", {"one": File(b"new"), "two": File(b"new", secret=True)})
    store.write(root / "install" / "new" / "deep", {"one": PUBLIC, "two": SECRET})
    store.write(root / "private" / "x", {"key.pem": SECRET})


@pytest.mark.parametrize("refusal", [errno.ENOSPC, errno.EACCES, errno.EROFS, errno.EDQUOT, errno.EIO, errno.EMFILE])
@pytest.mark.parametrize("call", CALLS)
def test_whichever_call_fails_files_are_whole_and_it_is_said_in_one_line(
    tmp_path: Path, call: str, refusal: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = getattr(os, call)
    said: list[tuple[str, str]] = []
    for at in itertools.count(1):
        root = tmp_path / str(at)
        store = Store({root: False, root / "install": False, root / "private": True}, root / ".keymint")
        prepared(store, root)
        calls = itertools.count(1)

        def failing(*arguments: Any, _at: int = at, _calls: Iterator[int] = calls, **options: Any) -> Any:
            if next(_calls) == _at:
                raise OSError(refusal, os.strerror(refusal))
            return real(*arguments, **options)

        with monkeypatch.context() as patch, umask(0o077):  # so that modes must be set
            patch.setattr(os, call, failing)
            try:
                everything(store, root)
                done = next(calls) <= at
                assert done or call == "mkdir", (
                    f"the {call} number {at} failed, and nobody was told"
                )  # mkdir is asked again
            except KeymintError as error:
                done = False
                said.append((error.diagnostics[0].code, one_line(error)))
        found = listing(root)
        assert not any(".keymint-" in path for path in found), found
        assert found["install/old/one"] in {"0644 b'old'", "0644 b'new'"}
        assert found["install/old/two"] in {"0600 b'old'", "0600 b'new'"}
        folder = root / "install" / "new" / "deep"
        assert not folder.exists() or names(folder) == {"one", "two"}
        everything(store, root)  # and a later run goes on from there
        if done:
            break
    assert len(said) >= 2
    assert all(code == "write-failed" and os.strerror(refusal) in line for code, line in said), said
    assert refusal != errno.ENOSPC or all("free some space" in line for _, line in said)


def test_a_write_that_ends_early_leaves_the_old_file(root: Path, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    store.write(root, {"file": File(b"old")})
    before = listing(root)

    def full(descriptor: int, data: bytes) -> int:
        if len(data) < 8:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(descriptor, data[:4])

    real = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        assert code_of(store.write, root, {"file": File(b"much longer than before")}) == "write-failed"
    assert listing(root) == before


def test_an_interrupt_before_the_rename_leaves_nothing_and_one_after_it_the_whole_folder(tmp_path: Path) -> None:
    fsync = os.fsync
    found = []
    for at in itertools.count(1):
        root, calls = tmp_path / f"ws{at}", itertools.count(1)

        def interrupted(descriptor: int, at: int = at, calls: Iterator[int] = calls) -> None:
            fsync(descriptor)
            if next(calls) == at:
                raise KeyboardInterrupt

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "fsync", interrupted)
            try:
                Store({root: False}, root / ".keymint").write(root / "a", {"one": PUBLIC})
            except KeyboardInterrupt:
                found.append(frozenset(listing(root)))
                continue
        break
    whole = frozenset({"a", "a/one"})
    assert list(dict.fromkeys(found)) == [frozenset(), whole]


def test_a_folder_that_someone_else_makes_meanwhile_is_written_into(
    root: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rename = os.rename
    folder = root / "install" / "a"

    def late(source: str, target: str, **options: Any) -> None:
        if target == "a" and not folder.exists():
            folder.mkdir()
            (folder / "theirs").write_bytes(b"theirs")
        rename(source, target, **options)

    monkeypatch.setattr(os, "rename", late)
    store.write(folder, {"ours": PUBLIC})
    assert set(listing(root / "install")) == {"a", "a/theirs", "a/ours"}


# -- a full, a closed and a read-only file system, for real ------------------------------------------------------

SCRIPT = textwrap.dedent("""
    import os, sys
    from pathlib import Path
    from keymint.errors import KeymintError
    from keymint.store.changes import File, FolderChange
    from keymint.store.store import Store
    root = Path(sys.argv[1])
    store = Store({root: False}, root / ".keymint")
    try:
        for number in range(int(sys.argv[2])):
            store.write(root / f"folder{number}", {"one": File(os.urandom(8000)), "two": File(os.urandom(8000))})
    except KeymintError as error:
        print(error)
        sys.exit(1)
""")


def unshared(command: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a shell command in a mount namespace of its own, in which it may mount."""
    may = subprocess.run(
        ["unshare", "-rm", "mount", "-t", "tmpfs", "none", "/mnt"], capture_output=True, check=False, text=True
    )
    if may.returncode:
        pytest.skip(f"file systems cannot be mounted here: {may.stderr.strip()}")
    return subprocess.run(
        ["unshare", "-rm", "sh", "-c", command, "sh", *arguments], capture_output=True, check=False, text=True
    )


def test_a_full_file_system_is_one_line_and_leaves_whole_folders(tmp_path: Path) -> None:
    ran = unshared(
        'mount -t tmpfs -o size=100k none "$1" && "$2" -c "$3" "$1" 50; echo "ended with $?"; cd "$1" && find . -type f'
        " -printf '%p %s\\n'",
        str(tmp_path),
        sys.executable,
        SCRIPT,
    )
    said, ended, *files = ran.stdout.splitlines()
    assert "No space left on device" in said
    assert "the previous files are intact" in said
    assert ended == "ended with 1"
    assert ran.stderr == ""
    assert len(files) >= 4
    assert all(line.split()[1] == "8000" and ".keymint-" not in line for line in files)
    assert sum("one" in line for line in files) == sum("two" in line for line in files)


def test_a_read_only_file_system_is_one_line(tmp_path: Path) -> None:
    ran = unshared('mount -t tmpfs -o ro none "$1" && "$2" -c "$3" "$1" 1', str(tmp_path), sys.executable, SCRIPT)
    assert ran.returncode == 1
    assert ran.stdout.count("\n") == 1
    assert "mounted read-only" in ran.stdout
    assert ran.stderr == ""


def test_a_folder_of_someone_else_is_one_line() -> None:
    nobody = 65534
    folder = Path("/usr")
    if os.geteuid() not in {0, folder.stat().st_uid} and os.access(folder, os.W_OK):
        pytest.skip("/usr may be written to")
    # What the interpreter imports from must be readable for nobody, too; so it is imported before root is given up.
    loaded = "import os, shutil\nimport keymint.store.store\n"
    drop = f"{loaded}if os.geteuid() == 0: os.setgid({nobody}); os.setuid({nobody})\n"
    ran = subprocess.run(
        [sys.executable, "-c", drop + SCRIPT, str(folder), "1"], capture_output=True, check=False, text=True
    )
    assert ran.stderr == ""
    assert ran.returncode == 1
    assert ran.stdout.count("\n") == 1
    assert "Permission denied" in ran.stdout
    assert "check the owner" in ran.stdout


# -- sessions ----------------------------------------------------------------------------------------------------


def test_only_one_holds_the_lock_and_the_other_says_that_it_waits(root: Path, store: Store) -> None:
    order: list[str] = []
    waits = threading.Event()

    def second() -> None:
        other = Store({root: False}, root / ".keymint")

        def on_wait(_process: str) -> None:
            order.append("waits")
            waits.set()

        with other.locked(on_wait):
            order.append("second")

    thread = threading.Thread(target=second)
    with store.locked(lambda _: order.append("never")):
        thread.start()
        assert waits.wait(10)
        order.append("first ends")
    thread.join(10)
    assert order == ["waits", "first ends", "second"]


def test_the_lock_of_a_process_that_died_is_free(root: Path, store: Store) -> None:
    script = textwrap.dedent("""
        import os, sys
        from pathlib import Path
        from keymint.store.store import Store
        root = Path(sys.argv[1])
        Store({root: False}, root / ".keymint").locked(lambda _: None).__enter__()
        os.kill(os.getpid(), 9)
    """)
    ran = subprocess.run([sys.executable, "-c", script, str(root)], check=False)
    assert ran.returncode == -9
    with store.locked(lambda _: pytest.fail("waits for a process that is dead")):
        pass


def test_stores_that_share_a_private_folder_exclude_each_other(root: Path) -> None:
    private = root / "private"
    order: list[str] = []
    made, waits = threading.Event(), threading.Event()

    def second_waits(_process: str) -> None:
        order.append("second waits")
        waits.set()

    def second() -> None:
        with other.locked(lambda _: pytest.fail("waits for another workspace that has no private folder yet")):
            ready.set()
            assert made.wait(10)
            order.append(f"second finds work {other.lock_missing(second_waits)}")
            assert other.missing == ()
        with other.locked(lambda _: None):
            order.append(f"second has it {other.lock_missing(lambda _: None)}")

    one, other = (Store({root: False, private: True}, root / name) for name in ("one", "other"))
    ready = threading.Event()
    thread = threading.Thread(target=second)
    with one.locked(lambda _: pytest.fail("waits for nobody")):
        thread.start()
        assert ready.wait(10)
        assert one.missing == (str(private),)
        assert not one.lock_missing(lambda _: pytest.fail("waits for nobody"))
        assert stat.S_IMODE(private.stat().st_mode) == 0o700
        made.set()
        assert waits.wait(10)
        one.write(private, {"key": File(b"", secret=True)})
    thread.join(10)
    assert order == ["second waits", "second finds work True", "second has it False"]


def test_the_lock_is_free_after_an_error(store: Store) -> None:
    with pytest.raises(ValueError, match="inside"), store.locked(lambda _: None):
        raise ValueError("inside")
    with store.locked(lambda _: pytest.fail("waits for itself")):
        pass


def test_a_run_that_ends_well_takes_its_mark_back(root: Path, store: Store) -> None:
    assert not store.is_marked()
    store.begin(Journal("keymint build"))
    assert store.is_marked()
    assert (root / ".keymint" / "running").stat().st_mode & 0o777 == 0o600
    assert store.recover() == Journal("keymint build")
    store.end()
    assert not store.is_marked()
    assert store.recover() is None


def test_a_journal_that_cannot_be_read_has_nothing_to_finish(root: Path, store: Store) -> None:
    for content in (b"", b"0123", b"\0" * 10, Journal("x").dump(root)[:-9]):
        store.write(root / ".keymint", {"running": File(content)})
        assert store.recover() == Journal()


def leave_behind(root: Path) -> None:
    for path in ("src/.keymint-7-0.tmp", "install/a/.keymint-7-1.tmp", "install/.keymint-7-2.tmp/key.pem"):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_bytes(b"half")
    (root / "install" / ".keymint-7-3.tmp" / "b" / "c").mkdir(parents=True)
    (root / "install" / ".keymint-7-3.tmp" / "b" / "c" / "key.pem").write_bytes(b"half")


def test_what_a_killed_run_left_behind_is_swept_away_and_nothing_else(root: Path, store: Store) -> None:
    store.write(root / "install" / "a", {"file": PUBLIC})
    store.write(root / "install" / "empty" / "x", {"file": PUBLIC})
    (root / "install" / "empty" / "x" / "file").unlink()
    store.write(root / "src", {"file": PUBLIC})
    for name in (".keymint-notes", "x.tmp", "keymint-1.tmp"):
        (root / name).write_bytes(b"a user's")
    store.begin(Journal())
    before = listing(root)
    leave_behind(root)
    store.recover()
    assert listing(root) == before


def test_without_a_mark_only_the_records_are_searched(root: Path, store: Store) -> None:
    leave_behind(root)
    (root / ".keymint").mkdir()
    (root / ".keymint" / ".keymint-7-4.tmp").write_bytes(b"half a mark")
    store.recover()
    assert (root / "src" / ".keymint-7-0.tmp").exists()
    assert list((root / ".keymint").iterdir()) == []


def test_a_sweep_follows_no_link(tmp_path: Path, root: Path, store: Store) -> None:
    leave_behind(tmp_path / "elsewhere")
    store.begin(Journal())
    (root / "install").mkdir()
    (root / "install" / "link").symlink_to(tmp_path / "elsewhere")
    (root / "install" / ".keymint-1-1.tmp").mkdir()
    (root / "install" / ".keymint-1-1.tmp" / "link").symlink_to(tmp_path / "elsewhere" / "install")
    before = listing(tmp_path / "elsewhere")
    store.recover()
    assert listing(tmp_path / "elsewhere") == before
    assert not (root / "install" / ".keymint-1-1.tmp").exists()


def test_a_workspace_inside_a_folder_with_a_name_like_a_temporary_one_is_not_swept_away(tmp_path: Path) -> None:
    root = tmp_path / ".keymint-1-1.tmp" / "ws"
    store = Store({root: False}, root / ".keymint")
    store.write(root / "a", {"file": PUBLIC})
    store.begin(Journal())
    store.recover()
    assert (root / "a" / "file").read_bytes() == b"public"


def test_the_status_of_a_new_folder_is_known_as_it_was_staged(store: Store, root: Path) -> None:
    new = {f"new/{each}": {"a": PUBLIC, "key": SECRET} for each in ("inner", "other/deep")}
    changes = [FolderChange(root / folder, files) for folder, files in new.items()]
    changes.append(FolderChange(root / "new/linked", {"link": File(b"", link="a")}))
    changes.append(FolderChange(root / "top", {"a": PUBLIC}))
    store.commit(store.stage(changes))
    found = {each: status for each, status in store.seen.items() if status.files}
    assert found == {str(root / folder): folder_status(str(root / folder)) for folder in new}
    assert store.seen[str(root / "new")].folders == ("inner", "linked", "other")
    (root / "new/inner/a").write_bytes(b"PUBLIC")
    assert folder_status(str(root / "new/inner")) != store.seen[str(root / "new/inner")]
