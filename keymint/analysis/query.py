# SPDX-License-Identifier: Apache-2.0
"""Parse queries such as ``who can publish /scan``."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.patterns.glob import parse
from comarmor.patterns.tokens import PatternError
from comarmor.text import did_you_mean
from comarmor.values import dataclass
from keymint.errors import ExitCode, KeymintError
from keymint.names import typed_permission, typed_subject

FORMS = (
    "who can PERMISSION OBJECT",
    "what can SUBJECT do",
    "can SUBJECT [ever] PERMISSION OBJECT",
    "flows SUBJECT SUBJECT",
    "isolated SUBJECT SUBJECT",
)
"""Queries: words in small letters are written as they are; the one in brackets may be left out."""
_OPTIONAL = "[ever]"
HEADS = tuple(form.split()[0] for form in FORMS)


@dataclass(frozen=True, slots=True)
class PolicyQuery:
    """A parsed query.

    Attributes:
        head: ``who``, ``what``, ``can``, ``flows`` or ``isolated``.
        subjects: expressions of subjects.
        kind: kind of the object; empty without an object.
        permission: a permission of that kind.
        object: expression of the object.
    """

    head: str
    subjects: tuple[str, ...]
    kind: str = ""
    permission: str = ""
    object: str = ""


def parse_query(words: Sequence[str], kind: str = "") -> PolicyQuery:
    """Parse the words of a query.

    Args:
        words: the words.
        kind: kind of the object; empty if it follows from the words.

    Raises:
        KeymintError: the query has none of the forms.
    """
    head, rest = (words[0], list(words[1:])) if words else ("", [])
    if head not in HEADS:
        hint = did_you_mean(head, HEADS, f"queries are: {'; '.join(FORMS)}")
        raise _error(f"no query starts with {head!r}" if head else "the query is empty", hint)
    form = next(form for form in FORMS if form.startswith(head))
    expected = [word for word in form.split()[1:] if word != _OPTIONAL]
    if _OPTIONAL in form and rest[1:2] == [_OPTIONAL.strip("[]")]:
        del rest[1]
    for at, word in enumerate(expected):
        if word.islower() and rest[at : at + 1] != [word]:
            found = f", not {rest[at]!r}" if at < len(rest) else ""
            raise _error(f"expected {word!r}{found}", f"write '{form}'")
    if len(rest) != len(expected):
        raise _error(f"the query has too {'few' if len(rest) < len(expected) else 'many'} words", f"write '{form}'")
    subjects = tuple(
        _expression(typed_subject(text)) for text, word in zip(rest, expected, strict=True) if word == "SUBJECT"
    )
    if "OBJECT" not in expected:
        return PolicyQuery(head, subjects)
    *_, permission, name = rest
    return PolicyQuery(head, subjects, *typed_permission(permission, name, kind), _expression(name))


def _expression(text: str) -> str:
    try:
        parse(text)
    except PatternError as error:
        diagnostic = error.diagnostics[0]
        raise _error(f"{text!r}: {diagnostic.message}", diagnostic.help) from None
    return text


def _error(message: str, help_: str) -> KeymintError:
    return KeymintError(message, help=help_, code="question", exit_code=ExitCode.USAGE)
