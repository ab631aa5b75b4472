# SPDX-License-Identifier: Apache-2.0
"""Access files inside a folder only: neither ``..`` nor a symbolic link leads outside, and reads are bounded.

An include names a file by the relative path of it, or as a file that a package ships.
"""

from __future__ import annotations

import errno
import os
import posixpath
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import unquote, urlsplit

from comarmor.errors import ComArmorError, Origin
from comarmor.text import did_you_mean, lazy_regex, quote
from comarmor.values import Data

_SPECIAL = {"", ".", ".."}
"""Parts of a path that are no name."""
FOLLOW_LINKS = "--trust-links follows it, e.g. in what 'colcon build --symlink-install' made"
"""What to do about a link that leads out of a package."""


class SandboxedFolder(Data):
    """A folder that file access is confined to.

    Attributes:
        real: its resolved path.
        shown: the path as the user would type it.
        package: name of the package that ships it; empty for a folder of the policy's owner.
        path: its path, if ``shown`` is none.
        trusts_links: its symbolic links may lead anywhere.
        absent_is_empty: a file that it does not have counts as an empty one.
    """

    real: Path
    shown: str
    package: str = ""
    path: Path | None = None
    trusts_links: bool = False
    absent_is_empty: bool = False

    def name(self, relative: str) -> str:
        """Return the path of a file in this folder as the user would type it."""
        return path_text(relative if self.shown == "." else posixpath.join(self.shown, relative))

    def place(self, relative: str) -> Path:
        """Return the path of a file in this folder, before links are resolved."""
        return Path(self.path or self.shown, relative)

    def resolve(self, relative: str, where: Origin) -> Path:
        """Return the resolved path of a file in this folder, whether or not it exists.

        Raises:
            ComArmorError: the path leads outside of the folder, also by ``..`` or a symbolic link.
        """
        names, real = relative.split("/"), self.real / relative
        outside = names[0] == ".."
        with file_errors("the file", where):
            below = [real, *real.parents[: len(names) - 1]]
            if _SPECIAL.isdisjoint(names) and not any(each.is_symlink() for each in below):
                return real  # the folder is resolved, and there is no link below it
            real = real.resolve()
        if outside or not (self.trusts_links or real.is_relative_to(self.real)):
            copy = "copy the file into the folder, and include the copy"
            message = f"{quote(relative, 200)} is outside of the policy's folder {quote(path_text(self.shown), 200)}"
            help_ = FOLLOW_LINKS if self.package and not outside else copy
            raise ComArmorError(message, where=where, help=help_, code="include-outside")
        return real

    def read(self, real: Path, size: int, where: Origin) -> bytes:
        """Return at most ``size`` bytes of a file that :meth:`resolve` returned; see :func:`read_bounded`.

        Raises:
            ComArmorError: it cannot be read.
        """
        with file_errors("the file", where):
            return read_bounded(real.parent if self.trusts_links else self.real, real, size)

    def find(self, relative: str, where: Origin) -> Path | None:
        """Return the resolved path of a file in this folder, or None if there is none.

        Raises:
            ComArmorError: the path leads outside of the folder, or cannot be accessed.
        """
        with file_errors("the file", where), suppress(FileNotFoundError, NotADirectoryError):
            real = self.resolve(relative, where)
            real.lstat()
            return real
        return None

    def similar_file(self, relative: str, including: str = "") -> str:
        """Return a hint at a file with a similar name in the folder of a missing file.

        Args:
            relative: path of the missing file.
            including: the including file as messages name it; it is not suggested.
        """
        parent, missing = posixpath.split(relative)
        try:
            names = [entry.name for entry in (self.real / parent).iterdir()]
        except OSError:
            return ""
        names = [name for name in names if self.name(posixpath.join(parent, name)) != including]
        below = sorted(path.relative_to(self.real).as_posix() for path in (self.real / parent).glob(f"*/{missing}"))
        return did_you_mean(missing, names, f"did you mean {quote(below[0])}?" if len(below) == 1 else "")


@contextmanager
def file_errors(what: str, where: Origin, code: str = "unreadable") -> Iterator[None]:
    """Raise what the file system refuses in a block as a :class:`ComArmorError`.

    Args:
        what: what is read, for the message of :func:`read_failure`.
        where: the place of the error.
        code: its code.
    """
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:
        raise ComArmorError(read_failure(error, what), where=where, code=code) from None


def read_bounded(folder: Path, real: Path, size: int) -> bytes:
    """Return at most ``size`` bytes of a regular file below a folder.

    Each folder of the path is opened relative to the previous one, and none may be a symbolic link. So a path that was
    resolved and checked cannot be swapped for one that leads outside.
    """
    *folders, last = real.relative_to(folder).parts
    here = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        for part in folders:
            inner = os.open(part, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=here)
            os.close(here)
            here = inner
        # Without O_NONBLOCK, opening a named pipe would block.
        file = os.open(last, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=here)
    finally:
        os.close(here)
    try:
        with os.fdopen(file, "rb", closefd=False) as stream:  # it raises an error for a folder, and leaves it open
            if not stat.S_ISREG(os.fstat(file).st_mode):
                raise OSError(errno.EINVAL, "it is not a regular file")
            return stream.read(size)
    finally:
        os.close(file)


def read_failure(error: Exception, what: str) -> str:
    """Return a message why a file or folder cannot be read."""
    if isinstance(error, FileNotFoundError):
        return f"{what} does not exist"
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"{what} cannot be read: {reason}"


def path_text(path: str) -> str:
    """Return a path as UTF-8 text; bytes that are not UTF-8 are escaped."""
    return path.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


PACKAGE = "package://"
"""Begin of an ``href`` that names a file of a ROS package, as in URDF and in ``resource_retriever``."""
_PACKAGE_NAME = lazy_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,254}")
"""Names of ROS packages (REP 127), with the exemptions that ament_index makes: capitals, digits in front, dashes."""
_SEGMENT = lazy_regex(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,254}")


def package_path(href: str, where: Origin) -> tuple[str, str] | None:
    """Return the package of the file that the ``href`` of an include names, and the path below its folder of profiles.

    None if it begins in another way.

    Args:
        href: the attribute: ``package://PACKAGE/PATH``.
        where: the place of the element.

    Raises:
        ComArmorError: ``include-href``: the package has no legal name, or there is no path; ``include-outside``: the
            path leads out of the package.
    """
    if not href.startswith(PACKAGE):
        return None
    package, _, rest = href.removeprefix(PACKAGE).partition("/")
    if not is_package_name(package):
        message = f"{quote(package)} is not the name of a package"
        help_ = "write package://PACKAGE/FILE.xml; a name has letters, digits, '_' and '-', a letter or digit first"
        raise ComArmorError(message, where=where, help=help_, code="include-href")
    if not rest:
        message = f"the href {quote(href)} of xi:include names no file"
        help_ = f"write {PACKAGE}{package}/FILE.xml; 'keymint plugins' lists the files that packages ship"
        raise ComArmorError(message, where=where, help=help_, code="include-href")
    return package, checked_path(path_of(rest, where), where)


def is_package_name(name: str) -> bool:
    """Tell whether a text can be the name of a ROS package."""
    return _PACKAGE_NAME.fullmatch(name) is not None


def checked_path(path: str, where: Origin) -> str:
    """Return the normalized path of a file of a package, which will become a path in a workspace too.

    Raises:
        ComArmorError: ``include-outside``: it leads out of the package; ``include-href``: it has other characters than
            letters, digits, ``_``, ``.``, ``+`` and ``-``, or a hidden part, or does not end in ``.xml``.
    """
    normal = posixpath.normpath(path)
    if normal.split("/", 1)[0] == "..":
        message = f"the path {quote(path, 200)} leads out of the package's folder of profiles"
        help_ = "a package ships its profiles in share/PACKAGE/keymint/comarmor.d; name a file below it"
        raise ComArmorError(message, where=where, help=help_, code="include-outside")
    if not all(map(_SEGMENT.fullmatch, normal.split("/"))) or not normal.endswith(".xml"):
        message = f"the path {quote(path, 200)} of a package's file is not plain"
        help_ = "expected a path that ends in .xml, of letters, digits, '_', '.', '+' and '-', without hidden parts"
        raise ComArmorError(message, where=where, help=help_, code="include-href")
    return normal


def path_of(href: str, where: Origin) -> str:
    """Return the path that the ``href`` of an ``xi:include`` names (XInclude 1.0, 3.1), with its escapes resolved.

    Args:
        href: the attribute.
        where: the place of the element.

    Raises:
        ComArmorError: ``include-href``: it is no path, e.g. an address or a query. ``include-outside``: it is absolute.
    """
    try:
        parts = urlsplit(href)
    except ValueError:
        parts = None
    path = unquote(href)
    if not path or "\0" in path or parts is None or parts.scheme or parts.netloc or parts.query or parts.fragment:
        raise ComArmorError(
            f"the href {quote(href)} of xi:include is not a relative path of a file", where=where, code="include-href"
        )
    if posixpath.isabs(path):
        message = f"xi:include of the absolute path {quote(path)}, expected one relative to the including file"
        help_ = "copy the file into the policy's folder, and include the copy"
        raise ComArmorError(message, where=where, help=help_, code="include-outside")
    return path
