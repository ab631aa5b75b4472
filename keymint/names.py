# SPDX-License-Identifier: Apache-2.0
"""Check the names of subjects, which become names of packages and paths of folders.

A subject is a fully qualified ROS name (:mod:`comarmor.rules`). No name becomes a path before it is checked here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate

from comarmor.rules import KIND_OF, PERMISSIONS, is_fully_qualified, is_segment
from comarmor.text import did_you_mean, natural_order, quote
from keymint.errors import KeymintError, Origin, usage_error

MAX_SEGMENT = 200
"""Bytes of a segment: file systems allow 255, and the names of temporary files need some of them."""
MAX_NAME = 1000
"""Bytes of a name: Linux' PATH_MAX is 4096, and includes the path of the workspace."""
RESERVED = "KEYMINT_IGNORE"
"""The marker file that hides a folder of packages; a segment of this name, in any case, would collide with it."""
_LISTED = 8
"""Names in one line of text; ``--json`` has all."""
_EXAMPLE = "a name is '/' and segments, e.g. /robot1/talker"
RAW = "topic"
"""The kind of the names of a transport, as they are."""
_BEGINS = ("/", "*", "?", "[", "\\")
"""What expressions of ROS names begin with."""
ROOT = "root-enclave"
"""Package name of the root enclave, whose subject is ``/``; no other subject can have it, because of its ``-``."""


def subject_of(name: str) -> str:
    """Return the subject of a package: ``/robot1/arm`` for ``robot1/arm``, ``/`` for the root enclave."""
    return "/" if name == ROOT else f"/{name}"


def name_of(subject: str) -> str:
    """Return the package name of a subject: the inverse of :func:`subject_of`; the name is not checked."""
    return ROOT if subject == "/" else subject.removeprefix("/")


def package_name(text: str) -> str:
    """Return the package name for a name that a user typed: ``robot1/arm`` for ``/robot1/arm`` or ``robot1/arm``.

    The root enclave is ``/``, or the name of its package.

    Raises:
        KeymintError: the text is not a legal name; the message names the illegal part.
    """
    if text in {"/", ROOT}:
        return ROOT
    name = text.removeprefix("/").rstrip("/")
    if not name:
        raise _illegal(f"{text!r} is not a name", _EXAMPLE)
    if len(name) > MAX_NAME:
        raise _illegal(f"the name {quote(name, 40)} has {len(name)} characters, the maximum is {MAX_NAME}")
    if len(name) <= MAX_SEGMENT and is_fully_qualified(f"/{name}") and RESERVED.casefold() not in name.casefold():
        return name  # as almost all do; below it is said what is wrong
    not_legal = f"{quote(text, 80)} is not a legal name:"
    for segment in name.split("/"):
        if not is_segment(segment):
            legal = "only letters, digits and '_' are allowed, and no digit at the beginning"
            raise _illegal(f"{not_legal} in {quote(segment, 80)}, {legal}", _EXAMPLE)
        if segment.casefold() == RESERVED.casefold():
            message = f"{not_legal} {segment!r} is reserved for the file that hides packages"
            raise _illegal(message, "rename the subject", "name-reserved")
        if len(segment) > MAX_SEGMENT:
            length = len(segment)
            raise _illegal(f"the segment {quote(segment, 40)} has {length} characters, the maximum is {MAX_SEGMENT}")
    return name


def _illegal(message: str, help_: str = "", code: str = "name-illegal") -> KeymintError:
    return KeymintError(message, help=help_, code=code)


def subject_list(subjects: Sequence[str]) -> str:
    """Return subjects in one line: ``/a, /b``; of many the first, and how many more."""
    more = len(subjects) - _LISTED
    return ", ".join(sorted(subjects, key=natural_order)[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def refuse_case_collisions(names: Iterable[str]) -> None:
    """Refuse names that differ only by case: they are one folder on some file systems.

    Raises:
        KeymintError: two names, or leading parts of them, differ only by case.
    """
    seen: dict[str, str] = {}
    for name in sorted(set(names)):
        for prefix in accumulate(name.split("/"), "{}/{}".format):
            other = seen.setdefault(prefix.casefold(), prefix)
            if other != prefix:
                message = f"the names '/{other}' and '/{prefix}' differ only by case, and some file systems ignore it"
                raise _illegal(message, "rename one of them", "name-collision")


def refuse_reserved(name: str, reserved: Iterable[str]) -> None:
    """Refuse a package name that collides with a folder at the top of the install space.

    Args:
        name: the package name, legal.
        reserved: names of these folders.

    Raises:
        KeymintError: its first segment is one of them, in any case.
    """
    first = name.split("/", maxsplit=1)[0]
    if first.casefold() in {each.casefold() for each in reserved}:
        message = f"'/{name}' is not allowed in the layout of this workspace: {first!r} is a folder of keystores"
        raise _illegal(message, "rename the subject", "name-reserved")


def typed_subject(text: str) -> str:
    """Return the subject, or expression of subjects, that a user typed; the leading ``/`` is optional."""
    return text if text[:1] in ("/", "*") else f"/{text}"


def typed_permission(text: str, name: str, kind: str = "", begins: Sequence[str] = _BEGINS) -> tuple[str, str]:
    """Return the kind and the permission that a user typed; the prefix ``ros_`` is optional.

    ``publish``, ``subscribe`` and ``relay`` mean a raw topic if the name cannot be a ROS name. With a kind, they mean
    the permission of that kind.

    Args:
        text: the word, e.g. ``publish`` or ``ros_call``.
        name: name or expression of the object.
        kind: kind of the object, a key of :data:`comarmor.rules.PERMISSIONS`; empty if the user named none.
        begins: what ROS names begin with; by default what expressions of them do.

    Raises:
        KeymintError: there is no such permission, or the name cannot be one of a ROS object.
    """
    as_ros = name[:1] in begins or text not in PERMISSIONS[RAW]
    known = PERMISSIONS[kind] if kind else PERMISSIONS[RAW] if not as_ros else KIND_OF.keys() - PERMISSIONS[RAW]
    permission = next((each for each in (text, f"ros_{text}") if each in known), None)
    if permission is None:
        words = tuple(dict.fromkeys(each.removeprefix("ros_") for each in PERMISSIONS.get(kind, KIND_OF)))
        of_kind = f" of a {kind}" if kind else ""
        hint = did_you_mean(text, (*words, *KIND_OF), f"permissions are {', '.join(words)}")
        raise usage_error(f"there is no permission {text!r}{of_kind}", hint, "permission-unknown")
    found = KIND_OF[permission]
    if found != RAW and name[:1] not in begins:
        raw = f", or the raw topic {name!r} by --kind {RAW}" if found == "ros_topic" else ""
        message = f"a {found} has no name {name!r}: ROS names begin with '/'"
        raise usage_error(message, f"did you mean {'/' + name!r}{raw}?", "object-name")
    return found, permission


def no_subject(help_: str, where: Origin | None = None) -> KeymintError:
    """Return the error that a policy names subjects by wildcards only.

    Args:
        help_: how the user can name some.
        where: the policy.
    """
    return KeymintError("the policy names no subject exactly", where=where, help=help_, code="subjects-none")
