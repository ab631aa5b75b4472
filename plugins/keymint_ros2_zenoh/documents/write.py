# SPDX-License-Identifier: Apache-2.0
"""Write a configuration: JSON with comments, which every JSON5 reader reads, the same bytes for the same data."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from keymint_ros2_zenoh.documents.access_control import PROPERTIES, AccessControl, AclPolicy, AclRule, AclSubject
from keymint_ros2_zenoh.documents.configuration import Configuration

_WIDTH = 120


def write(configuration: Configuration, title: Sequence[str]) -> bytes:
    """Return a configuration as a file.

    Every setting that a :class:`Configuration` has an attribute for is written, also if it has Zenoh's default.

    Args:
        configuration: what the file says.
        title: lines of the comment at its beginning.
    """
    members = _tree(configuration.other, _settings(configuration))
    lines = [*(f"// {line}".rstrip() for line in title), "{"]
    blocks = [[f"  {_text(key)}: {part}" for part in [_value(value, 2)]] for key, value in members.items()]
    blocks.append([*_access_control(configuration.access_control)])
    for number, block in enumerate(blocks, 1):
        if number < len(blocks):
            block[-1] += ","
        lines += block
    return "\n".join([*lines, "}", ""]).encode()


def _settings(configuration: Configuration) -> Iterator[tuple[str, Any]]:
    for path, value in configuration.settings().items():
        if value not in ("", ()) or path.endswith("/endpoints"):
            yield path, value


def _tree(other: Mapping[str, Any], settings: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return settings by path as nested objects; those that access depends on come first."""
    tree: dict[str, Any] = {}
    for path, value in (*settings, *sorted(other.items())):
        *parents, name = path.split("/")
        place = tree
        for parent in parents:
            place = place.setdefault(parent, {})
        place[name] = value
    return tree


def _access_control(control: AccessControl) -> Iterator[str]:
    yield '  "access_control": {'
    yield f'    "enabled": {_text(control.enabled)},'
    yield f'    "default_permission": {_text(control.default_permission)},'
    yield from _list("rules", control.rules, _rule)
    yield from _list("subjects", control.subjects, _subject)
    yield from _list("policies", control.policies, _policy, end="")
    yield "  }"


def _list(name: str, items: Sequence[Any], member: Any, end: str = ",") -> Iterator[str]:
    if not items:
        yield f'    "{name}": []{end}'
        return
    yield f'    "{name}": ['
    for number, item in enumerate(items, 1):
        comma = "," if number < len(items) else ""
        yield f"      {_value(dict(member(item)), 6)}{comma}"
    yield f"    ]{end}"


def _rule(rule: AclRule) -> Iterator[tuple[str, Any]]:
    yield "id", rule.id
    yield "permission", rule.permission
    yield "flows", rule.flows
    yield "messages", rule.messages
    yield "key_exprs", rule.key_exprs


def _subject(subject: AclSubject) -> Iterator[tuple[str, Any]]:
    yield "id", subject.id
    for name, attribute in PROPERTIES.items():
        if values := getattr(subject, attribute):
            yield name, values


def _policy(policy: AclPolicy) -> Iterator[tuple[str, Any]]:
    yield "subjects", policy.subjects
    yield "rules", policy.rules


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
