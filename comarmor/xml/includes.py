# SPDX-License-Identifier: Apache-2.0
"""What formats accept as the ``href`` of an include: the relative path of a file, or a file that a package ships."""

from __future__ import annotations

import posixpath
from urllib.parse import unquote, urlsplit

from comarmor.errors import ComArmorError, Origin
from comarmor.regex import lazy_regex
from comarmor.text import quoted

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
        raise ComArmorError(
            f"{quoted(package)} is not the name of a package",
            where=where,
            help="write package://PACKAGE/FILE.xml; a name has letters, digits, '_' and '-', a letter or digit first",
            code="include-href",
        )
    if not rest:
        raise ComArmorError(
            f"the href {quoted(href)} of xi:include names no file",
            where=where,
            help=f"write {PACKAGE}{package}/FILE.xml; 'keymint plugins' lists the files that packages ship",
            code="include-href",
        )
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
        raise ComArmorError(
            f"the path {quoted(path, 200)} leads out of the package's folder of profiles",
            where=where,
            help="a package ships its profiles in share/PACKAGE/keymint/comarmor.d; name a file below it",
            code="include-outside",
        )
    if not all(map(_SEGMENT.fullmatch, normal.split("/"))) or not normal.endswith(".xml"):
        raise ComArmorError(
            f"the path {quoted(path, 200)} of a package's file is not plain",
            where=where,
            help="expected a path that ends in .xml, of letters, digits, '_', '.', '+' and '-', without hidden parts",
            code="include-href",
        )
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
            f"the href {quoted(href)} of xi:include is not a relative path of a file", where=where, code="include-href"
        )
    if posixpath.isabs(path):
        raise ComArmorError(
            f"xi:include of the absolute path {quoted(path)}, expected one relative to the including file",
            where=where,
            help="copy the file into the policy's folder, and include the copy",
            code="include-outside",
        )
    return path
