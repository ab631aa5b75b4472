"""Placeholders in distinguished names: ``{name}`` and its like, and no other use of braces."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

from comarmor.errors import Origin
from comarmor.text import did_you_mean
from keymint.errors import KeymintError

AUTHORITY = ("name",)
"""Of an authority: its name in the profile."""
SUBJECT = ("name", "subject", "common_name", "unique")
"""Of a package: its name, ``/`` + name, and the two that :mod:`keymint.pki.names` makes of that."""

_BRACES = re.compile(r"\{([^{}]*)\}|[{}]")


def check(text: str, known: Collection[str], where: Origin) -> str:
    """Return a text whose placeholders are all known.

    Raises:
        KeymintError: a placeholder is unknown, or a brace stands alone.
    """
    for found in _BRACES.finditer(text):
        if found.group(1) not in known:
            listed = ", ".join(f"{{{name}}}" for name in known)
            raise KeymintError(
                f"unknown placeholder {found.group()!r} in {text!r}",
                where=where,
                help=did_you_mean(found.group(1) or "", known, f"the placeholders are {listed}"),
                code="placeholder-unknown",
            )
    return text


def expand(text: str, values: Mapping[str, str]) -> str:
    """Return a checked text with each placeholder replaced by its value."""
    return _BRACES.sub(lambda found: values[found.group(1)], text)


def of_subject(subject: str) -> Mapping[str, str]:
    """Return the values of :data:`SUBJECT` for a subject such as ``/robot1/talker``."""
    from keymint.pki import names  # noqa: PLC0415 - brings cryptography, which takes 0.1 s to import

    return {
        "name": subject.removeprefix("/"),
        "subject": subject,
        "common_name": names.common_name(subject),
        "unique": names.unique_suffix(subject),
    }
