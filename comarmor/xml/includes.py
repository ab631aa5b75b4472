# SPDX-License-Identifier: Apache-2.0
"""What every format accepts as the ``href`` of an include: the relative path of a file, and nothing else."""

from __future__ import annotations

import posixpath
from urllib.parse import unquote, urlsplit

from comarmor.errors import ComArmorError, Origin
from comarmor.text import quoted


def path_of(href: str, where: Origin, *, help_: str = "") -> str:
    """Return the path that the ``href`` of an ``xi:include`` names (XInclude 1.0, 3.1), with its escapes resolved.

    Args:
        href: the attribute.
        where: the place of the element.
        help_: how to mend an absolute path.

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
            help=help_,
            code="include-outside",
        )
    return path
