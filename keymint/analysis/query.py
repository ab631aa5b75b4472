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
    if head in ("flows", "isolated"):
        return PolicyQuery(head, tuple(map(_subject, _exactly(rest, 2, form))))
    if head == "what":
        _fixed(rest, 0, "can", form)
        _fixed(rest, 2, "do", form)
        return PolicyQuery(head, (_subject(_exactly(rest, 3, form)[1]),))
    if head == "who":
        _fixed(rest, 0, "can", form)
        _, permission, name = _exactly(rest, 3, form)
        return PolicyQuery(head, (), *parse_permission(permission, name), _expression(name))
    if rest[1:2] == ["ever"]:
        del rest[1]
    subject, permission, name = _exactly(rest, 3, form)
    return PolicyQuery(head, (_subject(subject),), *parse_permission(permission, name), _expression(name))


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


def _exactly(words: list[str], number: int, form: str) -> list[str]:
    if len(words) != number:
        raise _error(f"the query has too {'few' if len(words) < number else 'many'} words", f"write '{form}'")
    return words


def _fixed(words: list[str], at: int, expected: str, form: str) -> None:
    if words[at : at + 1] != [expected]:
        raise _error(f"expected {expected!r}" + (f", not {words[at]!r}" if at < len(words) else ""), f"write '{form}'")


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
