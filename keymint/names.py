"""Which names are legal, and how a subject becomes the name of a package and the path of a folder.

A subject is a fully qualified ROS name: ``/`` and segments of ``[A-Za-z_][A-Za-z0-9_]*`` (ROS 2 design, "Topic and
service name mapping to DDS"). No name becomes a path before it went through here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from keymint.errors import KeymintError

_SEGMENT = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
MAX_SEGMENT = 200
"""Bytes of a segment: file systems end at 255, and temporary files need some of them."""
RESERVED = "KEYMINT_IGNORE"
"""The file that hides a folder of packages: as a segment it would be one folder with it, whatever its case."""
_TOPS_OF_KEYSTORES = ("enclaves", "private", "public")
"""What lies at the top of a keystore of the other layout (sros2's ``create_keystore``)."""
MAX_NAME = 1000
"""Bytes of a name: Linux' PATH_MAX is 4096, and the workspace's own path comes before it."""


def package_name(text: str) -> str:
    """Return the package name of what a user typed: ``/robot1/arm`` or ``robot1/arm`` is ``robot1/arm``.

    Raises:
        KeymintError: the text is not a legal name; says which part and why.
    """
    name = text.removeprefix("/").rstrip("/") if text != "/" else ""
    if not name:
        raise KeymintError(
            f"{text!r} is not a name",
            help="a name is '/' and segments, e.g. /robot1/talker",
            code="name-illegal",
        )
    if len(name) > MAX_NAME:
        raise KeymintError(
            f"the name {name[:40]!r}… has {len(name)} characters, {MAX_NAME} are the most",
            code="name-illegal",
        )
    for segment in name.split("/"):
        if not _SEGMENT.match(segment):
            shown = repr(segment) if len(segment) <= MAX_SEGMENT else f"{segment[:40]!r}…"
            raise KeymintError(
                f"{text[:80]!r} is not a legal name: {shown} is not letters, digits and '_' that begin with a "
                "letter or '_'",
                help="a name is '/' and segments, e.g. /robot1/talker",
                code="name-illegal",
            )
        if segment.casefold() == RESERVED.casefold():
            raise KeymintError(
                f"{text[:80]!r} is not a legal name: {segment!r} is reserved for the file that hides packages",
                help="rename the subject",
                code="name-reserved",
            )
        if len(segment) > MAX_SEGMENT:
            raise KeymintError(
                f"{segment[:40]!r}… has {len(segment)} characters, a segment may have {MAX_SEGMENT}",
                code="name-illegal",
            )
    return name


def refuse_case_collisions(names: Iterable[str]) -> None:
    """Refuse names that are one folder on a file system which ignores case.

    Raises:
        KeymintError: two names differ by case only, in any leading part.
    """
    seen: dict[str, str] = {}
    for name in sorted(set(names)):
        parts = name.split("/")
        for end in range(1, len(parts) + 1):
            prefix = "/".join(parts[:end])
            other = seen.setdefault(prefix.casefold(), prefix)
            if other != prefix:
                raise KeymintError(
                    f"the names '/{other}' and '/{prefix}' differ by case only, and would be one folder on some "
                    "file systems",
                    help="rename one of them",
                    code="name-collision",
                )


def refuse_reserved(name: str, layout: str) -> None:
    """Refuse a package name that would be taken for something else in the install space.

    Args:
        name: the package name, legal.
        layout: layout of the install space.

    Raises:
        KeymintError: in the flat layout, the enclave would lie where a keystore of the layout sros2 has other things.
    """
    first = name.split("/", maxsplit=1)[0]
    if layout == "flat" and first.casefold() in _TOPS_OF_KEYSTORES:
        raise KeymintError(
            f"'/{name}' cannot be a name in the layout 'flat': {first!r} is a folder of the layout 'sros2'",
            help="rename the subject, or use the layout 'sros2'",
            code="name-reserved",
        )
