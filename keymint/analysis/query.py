"""Questions to a policy, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from comarmor.patterns.glob import parse
from comarmor.patterns.tokens import PatternError
from comarmor.rules import PERMISSIONS
from comarmor.text import did_you_mean
from keymint.errors import ExitCode, KeymintError

FORMS = (
    "who can PERMISSION OBJECT",
    "what can SUBJECT do",
    "can SUBJECT [ever] PERMISSION OBJECT",
    "flows SUBJECT SUBJECT",
    "isolated SUBJECT SUBJECT",
)
HEADS = tuple(form.split()[0] for form in FORMS)
_KIND_OF = {permission: kind for kind, permissions in PERMISSIONS.items() for permission in permissions}
_PLAIN = tuple(permission.removeprefix("ros_") for permission in _KIND_OF)


@dataclass(frozen=True, slots=True)
class PolicyQuery:
    """A question.

    Attributes:
        head: ``who``, ``what``, ``can``, ``flows`` or ``isolated``.
        subjects: expressions of subjects.
        kind: kind of the object; empty if it is not about one.
        permission: a permission of that kind.
        object: expression of the object.
    """

    head: str
    subjects: tuple[str, ...]
    kind: str = ""
    permission: str = ""
    object: str = ""


def parse_query(words: Sequence[str]) -> PolicyQuery:
    """Return the question that words ask.

    Raises:
        KeymintError: it is none of the forms; says which is meant.
    """
    head, rest = (words[0], list(words[1:])) if words else ("", [])
    if head not in HEADS:
        hint = did_you_mean(head, HEADS, f"ask one of: {'; '.join(FORMS)}")
        raise _wrong(f"{head!r} begins no question" if head else "there is no question", hint)
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
    """Return the kind and the permission that a word means; ``ros_`` may be missing.

    ``publish``, ``subscribe`` and ``relay`` are about a raw DDS topic where the name cannot be a ROS name.

    Args:
        text: the word, e.g. ``publish`` or ``ros_call``.
        name: expression of the object.

    Raises:
        KeymintError: it means none.
    """
    with_ros = f"ros_{text}"
    if with_ros in _KIND_OF and (text not in _KIND_OF or name[:1] in tuple("/*?[\\")):
        return _KIND_OF[with_ros], with_ros
    if text in _KIND_OF:
        return _KIND_OF[text], text
    hint = did_you_mean(text, (*_KIND_OF, *_PLAIN), f"permissions are {', '.join(dict.fromkeys(_PLAIN))}")
    raise _wrong(f"there is no permission {text!r}", hint)


def _exactly(words: list[str], number: int, form: str) -> list[str]:
    if len(words) != number:
        raise _wrong(f"the question has {'too few' if len(words) < number else 'too many'} words", f"ask '{form}'")
    return words


def _fixed(words: list[str], at: int, wanted: str, form: str) -> None:
    if words[at : at + 1] != [wanted]:
        raise _wrong(f"expected {wanted!r}" + (f", not {words[at]!r}" if at < len(words) else ""), f"ask '{form}'")


def _subject(text: str) -> str:
    if text[:1] not in ("/", "*"):
        raise _wrong(f"{text!r} is no subject", f"a subject begins with '/': did you mean {'/' + text!r}?")
    return _expression(text)


def _expression(text: str) -> str:
    try:
        parse(text)
    except PatternError as error:
        diagnostic = error.diagnostics[0]
        raise _wrong(f"{text!r}: {diagnostic.message}", diagnostic.help) from None
    return text


def _wrong(message: str, help_: str) -> KeymintError:
    return KeymintError(message, help=help_, code="question", exit_code=ExitCode.USAGE)
