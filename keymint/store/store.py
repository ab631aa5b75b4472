# SPDX-License-Identifier: Apache-2.0
"""The only writer: confined, locked, atomic, and strict about modes.

* Every path is walked from one of the store's roots without following a link, so nothing is written elsewhere.
* Changes are staged under temporary names, and committed together: nothing is visible before all of it is written and
  synchronised. See :mod:`keymint.store.staged` and :mod:`keymint.store.group_commit`.
* A new folder appears complete. A folder in which several files change is swapped in one step; see
  :mod:`keymint.store.staged` and :mod:`keymint.store.file_writing`.
* A secret is 0600 from its first byte and its folder 0700, whatever the umask.
* What a killed run made visible in part, the next run finishes; the rest of it is removed. See
  :mod:`keymint.store.journal`.
* Writers hold the lock of the workspace, and that of a private space, which several workspaces may share. Readers hold
  them only while they read their inputs into memory. All take the lock of the workspace first.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from time import sleep  # waits, and does not tell the time

from comarmor.values import replace
from keymint.store import journal
from keymint.store.changes import File, FolderChange
from keymint.store.file_writing import FEW, FILE, reported, temporary
from keymint.store.group_commit import commit, make_visible
from keymint.store.journal import Journal
from keymint.store.open_folders import OpenFolders, Roots
from keymint.store.staged import Exchange, Staging, remove_staged, rmtree
from keymint.view.file_reading import is_temporary
from keymint.view.recorded_answers import FolderStatus
from keymint.view.stamps import MAX_RECORD
from keymint.view.tree import read_file

LOCK = "lock"
"""Name of the lock file in the folder of records; writers take it with :meth:`keymint.store.store.Store.locked`."""
_UNSUPPORTED = frozenset({errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP})
"""What file systems say that lock no folders; see flock(2), "NFS details"."""


@contextlib.contextmanager
def path_lock(path: Path, operation: int, on_wait: Callable[[str], None]) -> Iterator[bool]:
    """Hold the lock of a workspace, or that of a folder itself, for which it needs no file.

    If the path does not exist, or cannot be opened or locked to read (e.g. in a copy or on a read-only file system), it
    is read without the lock: no writer can take it there either.

    Args:
        path: the lock file, or the folder; if its file system locks no folders (e.g. NFS, to write), it is not locked.
        operation: ``LOCK_SH`` to read, which admits other readers; ``LOCK_EX`` to write.
        on_wait: called once before waiting for another process that holds the lock, with that process in words.

    Yields:
        Whether the lock is held.

    Raises:
        OSError: it cannot be locked to write.
    """
    try:
        opened = os.open(path, FILE)
    except OSError:
        yield False
        return
    locked = True
    try:
        try:
            wait_for_lock(opened, operation, on_wait)
        except OSError as error:
            if operation == fcntl.LOCK_EX and error.errno not in _UNSUPPORTED:
                raise
            locked = False
        yield locked
    finally:
        os.close(opened)


def wait_for_lock(lock: int, operation: int, on_wait: Callable[[str], None]) -> None:
    """Lock an open file with ``LOCK_SH`` or ``LOCK_EX``; calls ``on_wait`` before waiting for another process."""
    try:
        fcntl.flock(lock, operation | fcntl.LOCK_NB)
    except BlockingIOError:
        on_wait(_holder(lock))
        fcntl.flock(lock, operation)


def _holder(lock: int) -> str:
    """Return which process holds the lock of an open file, and whether it is stopped; empty if nothing tells."""
    status = os.fstat(lock)
    place = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    with contextlib.suppress(OSError, ValueError, IndexError, StopIteration):
        lines = [line.split() for line in Path("/proc/locks").read_text("ascii").splitlines()]
        number = next(each[4] for each in lines if each[5:6] == [place])  # of one that waits it is in another column
        state = Path(f"/proc/{number}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[0]
        stopped = f", which is stopped: 'kill -CONT {number}' lets it go on" if state == "T" else ""
        return f" (process {number}{stopped})"
    return ""


def clock(records: Path, since: int = 0) -> int:
    """Return the clock of the file system, in nanoseconds: no file that changes from now on gets an earlier time.

    Files that changed before have an earlier time, unless the clock ticks in steps of more than some milliseconds.

    Args:
        records: folder of the lock, which the caller holds; if its times cannot be set, the result is 0.
        since: what :func:`clock_now` returned: it is enough if the files that changed before that have an earlier time.
    """
    before = now = since or clock_now(records)
    for _ in range(10):
        now = clock_now(records)
        if now != before:
            break
        sleep(0.001)
    return now


def clock_now(records: Path) -> int:
    """Return the time that a file would get if it changed now, or 0; a file that just changed may have the same one."""
    file = records / LOCK
    try:
        status = file.stat()
        os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))  # changes nothing but the time of the change
        return file.stat().st_ctime_ns
    except OSError:
        return 0


class Store:
    """Writes below its roots.

    Args:
        roots: absolute folders that may be written to, each with whether it is private: then every folder below
            it is 0700. Each is created when needed.
        records: folder of the lock, the mark of a running command, and the record; below one of the roots.
    """

    def __init__(self, roots: Mapping[Path, bool], records: Path) -> None:
        self._roots = Roots(roots, records)
        self.common = self._roots.common
        """The new folders in which several processes stage, each with the name that it has until the commit."""
        self._records = records
        self._mark = records / journal.MARK
        self._locks = contextlib.ExitStack()
        self._journal: Journal | None = None
        self._is_new = False
        """The folder of records was new when the lock was taken."""
        self.missing: tuple[str, ...] = ()
        """The private folders that were missing when the lock was taken."""
        self.seen: dict[str, FolderStatus] = {}
        """The status of new folders without folders in them, as they were staged, by the path that each will have."""

    # -- sessions ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def locked(self, on_wait: Callable[[str], None]) -> Iterator[None]:
        """Hold the workspace lock exclusively, and the locks of the private folders, which others may share.

        Args:
            on_wait: called before waiting for another process that holds a lock, with that process in words.
        """
        with contextlib.ExitStack() as self._locks:
            with OpenFolders(self._roots) as folders, reported(self._records / LOCK):
                records = folders.open(str(self._records))
                self._is_new = not os.path.lexists(self._records / LOCK)
                lock = os.open(LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644, dir_fd=records)
                self._locks.callback(os.close, lock)
                wait_for_lock(lock, fcntl.LOCK_EX, on_wait)
            private = [root for root, private in self._roots.private.items() if private]
            self.missing = tuple(root for root in private if not os.path.isdir(root))
            for root in private:
                if root not in self.missing:
                    self._lock(root, on_wait)
            yield

    def _lock(self, root: str, on_wait: Callable[[str], None]) -> None:
        with reported(root):
            self._locks.enter_context(path_lock(Path(root), fcntl.LOCK_EX, on_wait))

    def lock_missing(self, on_wait: Callable[[str], None]) -> bool:
        """Create the private folders that were missing when :meth:`locked` was entered, and lock them.

        Args:
            on_wait: called before waiting for another process that holds a lock, with that process in words.

        Returns:
            Whether another run wrote to one of them meanwhile, so that what was planned is out of date.

        Raises:
            KeymintError: a link is in the way, or the system refuses.
        """
        written = False
        with OpenFolders(self._roots) as folders:
            for root in self.missing:
                folders.open(root)
                self._lock(root, on_wait)
                with reported(root):
                    written = written or bool(os.listdir(root))
        self.missing = ()
        return written

    def begin(self, intent: Journal) -> None:
        """Record what a run was asked for, before its first effect; from now on, what it commits is all or nothing."""
        self._journal = intent
        self._record(intent)

    def end(self) -> None:
        """Forget the intent of a run that is finished; nothing is written after it."""
        self._journal = None
        with reported(self._mark), contextlib.suppress(FileNotFoundError):
            os.unlink(self._mark)

    def _record(self, journal: Journal) -> None:
        self.write(self._records, {self._mark.name: File(journal.dump(self._records), mode=0o600)})

    def is_marked(self) -> bool:
        """Tell whether an earlier run did not finish."""
        return self._mark.exists()

    def recover(self) -> Journal | None:
        """Finish what an earlier run made visible in part, and remove what else it left behind.

        Returns:
            The journal of that run until another one begins or ends; None if the last run ended.

        Raises:
            KeymintError: the system refuses; it can be tried again.
        """
        marked = self.is_marked()
        # A run that is killed while it sets its mark leaves temporary files in the folder of records only. Without that
        # folder nothing tells whether a run ended.
        roots = [*self._roots.private] if marked or self._is_new else [str(self._records)]
        found = None
        if marked:
            found = journal.load(read_file(self._mark, MAX_RECORD) or b"", self._records)
            if found.exchanges:
                found = journal.recover(found, self._roots)
                self._record(found)  # before anything is removed, by which it is told what became visible
        for path in _temporary_paths(roots):
            with reported(path):
                if os.path.isdir(path) and not os.path.islink(path):
                    rmtree(path)
                else:
                    os.unlink(path)
        return found

    # -- writing -------------------------------------------------------------------------------------------------

    def stage(self, changes: Iterable[FolderChange]) -> tuple[Exchange, ...]:
        """Write changes beside their places, so that nothing of them is visible yet.

        Several processes may stage at the same time, if none of their changes is in a folder of another's.

        Args:
            changes: changes in this order; a folder may occur more than once. All changes in one folder take effect in
                one step, together with those in its subfolders. A root of the store is never replaced, because it may
                be a mount point; its files change one by one.

        Returns:
            What :meth:`commit` or :meth:`discard` needs, also in another process.

        Raises:
            KeymintError: a path is not below a root, a symbolic link is in the way, or the system refuses. Nothing is
                staged then.
        """
        return Staging(self._roots, self.seen).stage(changes)

    def stage_common(self, folders: Iterable[str]) -> tuple[Exchange, ...]:
        """Stage the new folders around folders in which several processes will stage: what they stage is inside.

        Args:
            folders: the first and last folders at least, in order, of those in which the processes stage.

        Returns:
            As :meth:`stage`. :attr:`common` tells the stores of the other processes where they stage.

        Raises:
            KeymintError: a path is not below a root, a symbolic link is in the way, or the system refuses. Nothing is
                staged then.
        """
        by_root: dict[str, set[str]] = {}
        for folder in folders:
            by_root.setdefault(self._roots.of(folder), set()).add(folder)
        exchanges: list[Exchange] = []
        try:
            with OpenFolders(self._roots) as opened:
                for root, places in by_root.items():
                    inner = os.path.commonpath(places) if len(places) > 1 else root
                    new = [each for each in self._roots.upward(inner) if not os.path.lexists(each)]
                    if not new:
                        continue
                    around, name = os.path.split(outer := new[-1])
                    # Its files are not counted: processes are used for more than a few.
                    exchanges.append(Exchange(0, around, name, staged := temporary(), size=FEW + 1))
                    opened.open(f"{around}/{staged}{inner.removeprefix(outer)}")
                    self.common.update({each: os.path.basename(each) for each in new} | {outer: staged})
        except BaseException:
            self.discard(exchanges)
            raise
        return tuple(exchanges)

    def commit(self, staged: Sequence[Exchange]) -> None:
        """Make staged changes visible and durable, in order; see :mod:`keymint.store.group_commit`.

        After :meth:`begin`, the next run finishes them if this one is killed or refused on the way.

        Raises:
            KeymintError: the system refuses.
        """
        begun = self._journal
        record = None if begun is None else lambda names: self._record(replace(begun, exchanges=names))
        commit(self._roots, staged, record)
        self.common.clear()

    def discard(self, staged: Iterable[Exchange]) -> None:
        """Remove what was staged."""
        with OpenFolders(self._roots, create=False) as folders:
            remove_staged(staged, folders)

    def change(self, changes: Iterable[FolderChange]) -> None:
        """Write and remove files; see :meth:`stage` and :meth:`commit`."""
        commit(self._roots, self.stage(changes))

    def write(self, folder: Path, files: Mapping[str, File]) -> None:
        """Write files into a folder, all in one step; see :meth:`change`."""
        self.change([FolderChange(folder, files)])

    def write_hint(self, name: str, content: bytes) -> None:
        """Write a file of the folder of records that a loss of power may damage: who reads it finds that out."""
        staged = self.stage([FolderChange(self._records, {name: File(content)})])
        with OpenFolders(self._roots) as folders, reported(self._records / name):
            for exchange in staged:
                make_visible(folders.open(exchange.folder), exchange)


def _temporary_paths(roots: Iterable[str]) -> Iterator[str]:
    """Yield the temporary files and folders below folders; what is in one of these folders goes with it."""
    for root in roots:
        for folder, folders, files in os.walk(root):
            yield from (f"{folder}/{name}" for name in (*folders, *files) if is_temporary(name))
            folders[:] = (name for name in folders if not is_temporary(name))
