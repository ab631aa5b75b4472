# SPDX-License-Identifier: Apache-2.0
"""Write a configuration: JSON with comments, which every JSON5 reader reads, the same bytes for the same data."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from keymint_ros2_zenoh.documents.configuration import PROPERTIES, AccessControl, AclRule, AclSubject, Configuration

_WIDTH = 120


def write(configuration: Configuration, title: Sequence[str]) -> bytes:
    """Return a configuration as a file.

    Every setting that a :class:`Configuration` has an attribute for is written, also if it has Zenoh's default.

    Args:
        configuration: what the file says.
        title: lines of the comment at its beginning.
    """
    given = configuration.settings().items()
    settings = {path: value for path, value in given if value not in ("", ()) or path.endswith("/endpoints")}
    tree = _tree(settings | dict(sorted(configuration.other.items())))
    members = [f"  {_text(key)}: {_value(value, 2)}" for key, value in tree.items()]
    members.append(_access_control(configuration.access_control))
    return "\n".join([*(f"// {line}".rstrip() for line in title), "{", ",\n".join(members), "}", ""]).encode()


def _tree(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings by path as nested objects."""
    tree: dict[str, Any] = {}
    for path, value in settings.items():
        *parents, name = path.split("/")
        place = tree
        for parent in parents:
            place = place.setdefault(parent, {})
        place[name] = value
    return tree


def _access_control(control: AccessControl) -> str:
    members = [
        f'    "enabled": {_text(control.enabled)}',
        f'    "default_permission": {_text(control.default_permission)}',
        _list("rules", map(_rule, control.rules)),
        _list("subjects", map(_subject, control.subjects)),
        _list("policies", ({"subjects": each.subjects, "rules": each.rules} for each in control.policies)),
    ]
    return "\n".join(['  "access_control": {', ",\n".join(members), "  }"])


def _list(name: str, items: Iterable[Mapping[str, Any]]) -> str:
    """Return a member with one item on each line, or more lines for an item that does not fit."""
    lines = ",\n".join(f"      {_value(item, 6)}" for item in items)
    return f'    "{name}": [\n{lines}\n    ]' if lines else f'    "{name}": []'


def _rule(rule: AclRule) -> Mapping[str, Any]:
    return {
        "id": rule.id,
        "permission": rule.permission,
        "flows": rule.flows,
        "messages": rule.messages,
        "key_exprs": rule.key_exprs,
    }


def _subject(subject: AclSubject) -> Mapping[str, Any]:
    given = {name: getattr(subject, attribute) for name, attribute in PROPERTIES.items()}
    return {"id": subject.id} | {name: values for name, values in given.items() if values}


def _text(value: Any) -> str:
    """Return a value on one line; other characters than ASCII are escaped, so that no reader mistakes one."""
    return json.dumps(value)


def _value(value: Any, indent: int) -> str:
    """Return a value on one line if it fits, else one member on each line."""
    line = _text(value)
    if indent + len(line) < _WIDTH or not value or not isinstance(value, dict | list | tuple):
        return line
    inner = " " * (indent + 2)
    if not isinstance(value, dict):
        return "\n".join(["[", *_filled([_value(item, indent + 2) for item in value], inner), " " * indent + "]"])
    parts = [f"{inner}{_text(key)}: {_value(item, indent + 2)}" for key, item in value.items()]
    return "\n".join(["{", ",\n".join(parts), " " * indent + "}"])


def _filled(parts: Sequence[str], indent: str) -> Iterator[str]:
    """Yield lines of as many parts as fit."""
    line = ""
    for number, part in enumerate(parts, 1):
        item = part + ("," if number < len(parts) else "")
        if line and len(indent) + len(line) + len(item) >= _WIDTH:
            yield indent + line
            line = ""
        line = f"{line} {item}" if line else item
    yield indent + line
