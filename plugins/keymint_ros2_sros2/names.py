# SPDX-License-Identifier: Apache-2.0
r"""Resolve the names of an SROS2 policy, as SROS2 does and as they read, and write them as expressions of ComArmor.

SROS2's stylesheet resolves names without a look at the rules of ROS names: it trims nothing, and ``~x`` in the node
``/ns/n`` becomes ``/ns/nx``. What it makes of a name is *enforced*; a person who reads the policy expects another
name, or an error. DDS compares the result as an ``fnmatch`` expression, in which braces mean themselves.
"""

from __future__ import annotations

from comarmor.errors import ComArmorError
from comarmor.language.attachments import MOST_CHARACTERS
from comarmor.patterns.expression import canonical
from comarmor.patterns.tokens import COMARMOR, tokenize
from comarmor.regex import lazy_regex
from comarmor.text import quoted
from keymint_ros2_sros2.syntax import Entry, RosNode

_PLAIN = lazy_regex(r"[\w/~.]*")
"""Names in which no character has a meaning: most names."""


def enforced_name(node: RosNode, text: str) -> str:
    """Return a name as SROS2's stylesheet resolves it in a node."""
    return _resolved(node.ns, node.name, text)


def as_read(node: RosNode, text: str) -> str:
    """Return a name as it reads: trimmed, ``~x`` as ``~/x``, in a namespace that begins with ``/``."""
    text, ns = text.strip(), node.ns.strip()
    if text.startswith("~") and text[1:2] not in ("", "/"):
        text = f"~/{text[1:]}"
    return _resolved(ns if ns.startswith("/") or not ns else f"/{ns}", node.name.strip(), text)


def _resolved(ns: str, node: str, text: str) -> str:
    base = "" if ns in ("", "/") else ns.removesuffix("/")
    if text.startswith("/"):
        return text
    if text.startswith("~"):
        return f"{base}/{node}{text[1:]}"
    return f"{base}/{text}"


def expression(name: str, entry: Entry) -> str:
    """Return the expression of ComArmor that matches what the standard's ``fnmatch`` matches.

    Args:
        name: a resolved name.
        entry: where it is written.

    Raises:
        ComArmorError: the name is too long, or contains notation that POSIX leaves undefined; with ``file:line``.
    """
    try:
        written = name if _PLAIN.fullmatch(name) else canonical(tokenize(name, COMARMOR))
    except ComArmorError as error:
        (diagnostic,) = error.diagnostics
        raise ComArmorError(
            f"{quoted(entry.text)}: {diagnostic.message}", where=entry.where, help=diagnostic.help, code="expression"
        ) from None
    if len(written) > MOST_CHARACTERS:
        raise ComArmorError(
            f"the name is longer than {MOST_CHARACTERS:,} characters", where=entry.where, code="expression"
        )
    return written
