# SPDX-License-Identifier: Apache-2.0
"""Parse queries such as ``who can publish /scan``."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.patterns.glob import parse
from comarmor.patterns.tokens import PatternError
from comarmor.rules import KIND_OF
from comarmor.text import did_you_mean
from comarmor.values import dataclass
from keymint.errors import ExitCode, KeymintError

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
_PLAIN = tuple(permission.removeprefix("ros_") for permission in KIND_OF)


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


def parse_query(words: Sequence[str]) -> PolicyQuery:
    """Parse the words of a query.

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
    subjects = tuple(_subject(text) for text, word in zip(rest, expected, strict=True) if word == "SUBJECT")
    if "OBJECT" not in expected:
        return PolicyQuery(head, subjects)
    *_, permission, name = rest
    return PolicyQuery(head, subjects, *parse_permission(permission, name), _expression(name))


def parse_permission(text: str, name: str) -> tuple[str, str]:
    """Return the kind and the permission for a word; ``ros_`` is optional.

    ``publish``, ``subscribe`` and ``relay`` mean a raw topic if the name cannot be a ROS name.

    Args:
        text: the word, e.g. ``publish`` or ``ros_call``.
        name: expression of the object.

    Raises:
        KeymintError: there is no such permission.
    """
    with_ros = f"ros_{text}"
    if with_ros in KIND_OF and (text not in KIND_OF or name[:1] in tuple("/*?[\\")):
        return KIND_OF[with_ros], with_ros
    if text in KIND_OF:
        return KIND_OF[text], text
    hint = did_you_mean(text, (*KIND_OF, *_PLAIN), f"permissions are {', '.join(dict.fromkeys(_PLAIN))}")
    raise _error(f"there is no permission {text!r}", hint)


def _subject(text: str) -> str:
    if text[:1] not in ("/", "*"):
        raise _error(f"{text!r} is not a subject", f"subjects begin with '/': did you mean {'/' + text!r}?")
    return _expression(text)


def _expression(text: str) -> str:
    try:
        parse(text)
    except PatternError as error:
        diagnostic = error.diagnostics[0]
        raise _error(f"{text!r}: {diagnostic.message}", diagnostic.help) from None
    return text


def _error(message: str, help_: str) -> KeymintError:
    return KeymintError(message, help=help_, code="question", exit_code=ExitCode.USAGE)
