# SPDX-License-Identifier: Apache-2.0
"""Placeholders in distinguished names, such as ``{name}``; braces have no other use there."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from comarmor.regex import lazy_regex
from comarmor.text import did_you_mean
from keymint.api.source_documents import place, text
from keymint.errors import KeymintError

if TYPE_CHECKING:
    from lxml import etree

AUTHORITY = ("name",)
"""Placeholders of an authority: its name in the profile."""
SUBJECT = ("name", "subject", "common_name", "unique")
"""Placeholders of a package: its name, ``/`` + name, common name and unique suffix."""

_BRACES = lazy_regex(r"\{([^{}]*)\}|[{}]")


def read(element: etree._Element | None, known: Collection[str]) -> str | None:
    """Return the text of a ``<subject_name>``, or None if there is no element.

    Raises:
        KeymintError: a placeholder is not in ``known``, or a brace has no partner.
    """
    if element is None:
        return None
    name = text(element) or ""
    for match in _BRACES.finditer(name):
        if match.group(1) not in known:
            choices = ", ".join(f"{{{placeholder}}}" for placeholder in known)
            raise KeymintError(
                f"unknown placeholder {match.group()!r} in {name!r}",
                where=place(element),
                help=did_you_mean(match.group(1) or "", known, f"the placeholders are {choices}"),
                code="placeholder-unknown",
            )
    return name


def expand(name: str, values: Mapping[str, str]) -> str:
    """Replace each placeholder of a name that :func:`read` returned by its value.

    In the name of the root enclave ``/``, the common name comes first if a placeholder gives it: a grant has the RDNs
    the other way round, and Cyclone DDS finds none for a name in which a ``,`` follows the ``/``.
    """
    expanded = _BRACES.sub(lambda match: values[match.group(1)], name)
    if values.get("common_name") != "/" or expanded == name:
        return expanded
    from keymint.pki import distinguished_names  # noqa: PLC0415 - as in of_subject

    try:
        return distinguished_names.common_name_first(expanded)
    except KeymintError:
        return expanded  # reported where the certificate is made


def of_subject(subject: str, generation: int = 0, *, in_common_name: bool = False) -> Mapping[str, str]:
    """Return the values of :data:`SUBJECT` for a generation of a subject.

    Args:
        subject: the subject's name, e.g. ``/robot1/talker``.
        generation: generation of its identity; the unique suffix has it.
        in_common_name: its names have it as well, for a transport that knows a subject by its common name alone.
    """
    from keymint.pki import distinguished_names  # noqa: PLC0415 - imports cryptography, which takes 0.1 s

    named = generation if in_common_name else 0
    mark = distinguished_names.generation_mark(named)
    return {
        "name": subject.removeprefix("/") + mark,
        "subject": subject + mark,
        "common_name": distinguished_names.common_name(subject, named),
        "unique": distinguished_names.unique_suffix(subject, generation),
    }
