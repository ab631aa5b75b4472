# SPDX-License-Identifier: Apache-2.0
"""Make staged changes visible, all of them in one group.

Everything that was staged is synchronised first, then the names are exchanged in order, then the exchanges are
synchronised, and only then the old folders are removed. So a loss of power at any time leaves each folder as it was or
as it will be, and never an empty one.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Callable, Iterable, Mapping, Sequence

from keymint.store.file_writing import (
    FEW,
    UNABLE,
    exchange_names,
    open_at,
    reported,
    sync_file_system,
    sync_tree,
    temporary,
)
from keymint.store.open_folders import OpenFolders, Roots, close_to_others
from keymint.store.staged import NOT_EMPTY, Exchange, remove_staged
from keymint.view.file_reading import SUFFIX, is_temporary

WAITING = ".next"
"""Suffix of the name of a complete new folder whose place is being cleared."""


def commit(
    roots: Roots, exchanges: Sequence[Exchange], ready: Callable[[tuple[Exchange, ...]], None] | None = None
) -> None:
    """Make staged changes visible, in order.

    Args:
        roots: the roots of the store.
        exchanges: the names that change, in order, by what this process or others staged.
        ready: records the names that change, in order, once all of it is durable and before anything is visible.

    Raises:
        KeymintError: the system refuses. What is not visible yet is removed, unless it was recorded: then the next run
            finishes it. If it could not be synchronised, nothing became visible.
    """
    inner = _inside_replaced(exchanges)
    groups = _in_order(_outer_first(exchanges, inner), roots)
    recorded = False
    old: list[tuple[Exchange, str]] = []
    with OpenFolders(roots, create=False) as folders:
        try:
            # The next run looks for the temporary names in the journal, so they must be durable before it.
            whole = _sync(exchanges, folders, names=ready is not None)
            if ready is not None:
                recorded = True
                ready(tuple(exchange for group in groups for exchange in group))
            for group in groups:
                for exchange in group:
                    for moved in inner.get(f"{exchange.folder}/{exchange.name}", ()):
                        _move_along(exchange, moved, folders)
                    with reported(f"{exchange.folder}/{exchange.name}"):
                        left = make_visible(folders.open(exchange.folder), exchange)
                    if left is not None:
                        old.append((exchange, left))
                _sync(group, folders, whole)
            cleared = [exchange for exchange, _ in old]
            while old:
                _clear_away(*old[-1], folders)
                old.pop()
            # A run takes its mark back after this, and the next run removes what is left only if there is a mark.
            _sync(cleared, folders, whole)
        except BaseException:
            for exchange, left in old:
                with contextlib.suppress(Exception):
                    _clear_away(exchange, left, folders)
            if not recorded:
                remove_staged(exchanges, folders)
            raise


def _in_order(exchanges: Iterable[Exchange], roots: Roots) -> list[list[Exchange]]:
    """Return groups of exchanges; each group must be durable before the next one begins.

    Within a group, a loss of power may leave any of the exchanges: the next run finishes the others by its journal. But
    the register comes first, which stands before all other files of the private space, and keys before what is signed.
    """
    private: list[Exchange] = []
    others: list[Exchange] = []
    for exchange in exchanges:
        is_private = exchange.staged is not None and roots.private[roots.of(exchange.folder)]
        (private if is_private else others).append(exchange)
    return [group for group in (private[:1], private[1:], others) if group]


def make_visible(folder: int, exchange: Exchange) -> str | None:
    """Change one name.

    Returns:
        The name that the old folder has now, if there is one.
    """
    name, staged = exchange.name, exchange.staged
    if staged is not None and exchange.replaces:
        return _replace_folder(folder, exchange, staged)
    if staged is not None:
        try:
            os.rename(staged, name, src_dir_fd=folder, dst_dir_fd=folder)
        except OSError as error:
            if error.errno not in NOT_EMPTY:
                raise
            _move_into(exchange, folder, staged, (folder, name))  # another process created it meanwhile
    elif exchange.replaces:
        return _moved_away(folder, exchange)
    else:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(name, dir_fd=folder)
    return None


def waiting_name(staged: str) -> str:
    """Return the name of a staged folder from when the one in its place is moved away, until it has its place.

    It tells that this began, so that the next run finishes it if it is stopped in between.
    """
    return f"{staged.removesuffix(SUFFIX)}{WAITING}" if staged.endswith(SUFFIX) else staged


def _replace_folder(parent: int, exchange: Exchange, staged: str) -> str | None:
    """Put a complete folder in the place of another one, in one step where the file system can.

    Else the folder is missing for a moment, but old and new files are never mixed.

    Returns:
        The name that the old folder has now; None if it is already removed.
    """
    waiting = waiting_name(staged)
    if staged != waiting:
        try:
            exchange_names(parent, staged, exchange.name)
        except OSError as error:
            if error.errno not in UNABLE:
                raise
        else:
            return staged
        os.rename(staged, waiting, src_dir_fd=parent, dst_dir_fd=parent)
        os.fsync(parent)
    old = _moved_away(parent, exchange, (parent, waiting))
    os.rename(waiting, exchange.name, src_dir_fd=parent, dst_dir_fd=parent)
    return old


def _moved_away(parent: int, exchange: Exchange, new: tuple[int, str] | None = None) -> str | None:
    """Rename a folder away if it is there; return its temporary name.

    Args:
        parent: the open folder in which it is.
        exchange: the exchange of its name.
        new: what takes its place; see :func:`_move_into`.
    """
    away = temporary()
    try:
        os.rename(exchange.name, away, src_dir_fd=parent, dst_dir_fd=parent)
    except FileNotFoundError:
        return None
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        # overlayfs cannot rename a folder of a lower layer: remove file by file
        _move_into(exchange, parent, exchange.name, new)
        return None
    return away


def _clear_away(exchange: Exchange, left: str, folders: OpenFolders) -> None:
    """Remove the old folder of an exchange; what others put into it meanwhile moves to the place of the exchange."""
    with reported(f"{exchange.folder}/{exchange.name}"):
        parent = folders.open(exchange.folder)
        if not _move_into(exchange, parent, left, (parent, exchange.name)):
            os.rename(left, exchange.name, src_dir_fd=parent, dst_dir_fd=parent)


def _move_into(
    exchange: Exchange, parent: int, name: str, new: tuple[int, str] | None = None, inside: str = ""
) -> bool:
    """Remove a folder; what the run neither changes nor carried over moves to another one, also if it is staged.

    Args:
        exchange: the exchange of the folder, or of one around it.
        parent: the open folder in which it is.
        name: its name.
        new: the open folder in which the other one is, and its name, if there is one.
        inside: its path in the folder of the exchange, with a slash at its end.

    Returns:
        Whether it is removed; else there is no other one.

    Raises:
        OSError: the system refuses.
    """
    with open_at(name, parent) as old, contextlib.ExitStack() as opened:
        target: int | None = None
        with contextlib.suppress(FileNotFoundError):
            target = opened.enter_context(open_at(new[1], new[0])) if new else None
        if target is not None and not stat.S_IMODE(os.fstat(old).st_mode) & 0o077:
            close_to_others(target)
        for entry in sorted(os.scandir(old), key=lambda entry: entry.name):
            path = f"{inside}{entry.name}"
            is_ours = path in exchange.changed or exchange.carried.get(path) == entry.inode()
            if entry.is_dir(follow_symlinks=False) and not is_temporary(entry.name):
                inner = None if target is None else (target, entry.name)
                is_ours = _move_into(exchange, old, entry.name, inner, f"{path}/")
            elif is_ours:
                os.unlink(entry.name, dir_fd=old)
            if not is_ours and target is not None:
                os.rename(entry.name, entry.name, src_dir_fd=old, dst_dir_fd=target)
                with contextlib.suppress(FileNotFoundError):  # two names of one file: then nothing was renamed
                    os.unlink(entry.name, dir_fd=old)
                os.fsync(target)
    try:
        os.rmdir(name, dir_fd=parent)
    except OSError as error:
        if target is not None or error.errno not in NOT_EMPTY:
            raise
        return False
    return True


# -- what was staged inside of a folder that is replaced ---------------------------------------------------------


def _inside_replaced(exchanges: Iterable[Exchange]) -> dict[str, list[Exchange]]:
    """Return, for each folder that is replaced, the exchanges inside of it, which another process staged."""
    replaced = {f"{each.folder}/{each.name}" for each in exchanges if each.staged and each.replaces}
    inside: dict[str, list[Exchange]] = {}
    for exchange in exchanges if replaced else ():
        above = exchange.folder
        while above and exchange.staged:
            if above in replaced:
                inside.setdefault(above, []).append(exchange)
            above = above.rpartition("/")[0]
    return inside


def _outer_first(exchanges: Sequence[Exchange], inner: Mapping[str, Sequence[Exchange]]) -> Sequence[Exchange]:
    """Return exchanges in order, but that of a folder before those inside of it."""
    if not inner:
        return exchanges
    place = {id(exchange): at for at, exchange in enumerate(exchanges)}

    def first(exchange: Exchange) -> tuple[int, bool]:
        inside = inner.get(f"{exchange.folder}/{exchange.name}", ())
        return min(place[id(each)] for each in (exchange, *inside)), not inside

    return sorted(exchanges, key=first)


def _move_along(exchange: Exchange, moved: Exchange, folders: OpenFolders) -> None:
    """Move what was staged inside of a folder into the replacement of that folder."""
    relative = moved.folder[len(f"{exchange.folder}/{exchange.name}") :]
    with reported(moved.folder):
        source = os.dup(folders.open(moved.folder))
        try:
            target = folders.open(f"{exchange.folder}/{exchange.staged}{relative}")
            os.rename(str(moved.staged), str(moved.staged), src_dir_fd=source, dst_dir_fd=target)
        finally:
            os.close(source)


# -- durability --------------------------------------------------------------------------------------------------


def _sync(
    exchanges: Sequence[Exchange],
    folders: OpenFolders,
    whole: Mapping[int, bool] | None = None,
    *,
    names: bool = True,
) -> Mapping[int, bool]:
    """Synchronise what was staged, and the folders in which names change.

    Args:
        exchanges: the names.
        folders: opens their folders.
        whole: if only names changed since: file systems by their number, with whether each was synchronised as a whole.
        names: synchronise the folders.

    Returns:
        Such file systems.
    """
    of_folder: dict[str, list[Exchange]] = {}
    for exchange in exchanges:
        of_folder.setdefault(exchange.folder, []).append(exchange)
    is_many = sum(each.size for each in exchanges) > FEW if whole is None else len(of_folder) > 1
    done: dict[int, bool] = {}
    for folder, changing in of_folder.items():
        with reported(folder):
            opened = folders.open(folder)
            device = os.fstat(opened).st_dev
            if device not in done:
                done[device] = is_many and (whole is None or whole[device]) and sync_file_system(opened)
            if done[device]:
                continue
            for exchange in changing if whole is None else ():
                if exchange.staged is not None:
                    sync_tree(opened, exchange.staged)
            if names:
                folders.sync(folder)
    return done
