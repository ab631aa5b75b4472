# SPDX-License-Identifier: Apache-2.0
"""Read a configuration: the only reader, for checks, proofs, the model and real routers.

It refuses what Zenoh refuses at start, and every file that two readers could understand differently.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import fastjsonschema

from comarmor.data import locate
from comarmor.errors import Diagnostic, Origin
from comarmor.text import did_you_mean, quoted
from keymint.errors import KeymintError
from keymint_ros2_zenoh import keyexpr
from keymint_ros2_zenoh.documents import json5
from keymint_ros2_zenoh.documents.configuration import (
    DEFAULT_LISTEN,
    PROPERTIES,
    SETTINGS,
    AccessControl,
    AclPolicy,
    AclRule,
    AclSubject,
    Configuration,
    Flow,
    Message,
    Permission,
)
from keymint_ros2_zenoh.documents.json5 import Node

_LISTS = {"rules": "rule", "subjects": "subject", "policies": "policy"}
"""The lists of an access control, and what an item of each is."""
_MODELLED = frozenset((*SETTINGS, "access_control"))
_AROUND_MODELLED = frozenset(path[:at] for path in _MODELLED for at, char in enumerate(path) if char == "/")


@lru_cache(maxsize=8)
def read(content: bytes, name: str) -> Configuration:
    """Return a configuration.

    Args:
        content: the file.
        name: its path as the user would type it, for messages and places.

    Raises:
        KeymintError: not well-formed, or Zenoh would refuse it; every defect with its ``file:line``.
    """
    root = json5.parse(content, name)
    _validate(root, name)
    return _Reading(root, name).configuration()


@lru_cache(maxsize=1)
def _validator() -> Callable[[Any], Any]:
    path = locate("keymint_ros2_zenoh", "schemas") / "configuration.schema.json"
    validator: Callable[[Any], Any] = fastjsonschema.compile(json.loads(path.read_bytes()), use_default=False)
    return validator


def _validate(root: Node, name: str) -> None:
    try:
        _validator()(root.plain())
    except fastjsonschema.JsonSchemaValueException as error:
        node = root
        for step in error.path[1:]:
            inner = node.value.get(step) if isinstance(node.value, dict) else node.value[int(step)]
            if inner is None:
                break
            node = inner
        place = "/".join(error.path[1:]) or "the file"
        what = error.message.removeprefix(error.name or "").strip()
        raise KeymintError(
            f"{quoted(place, 200)} {quoted(what, 200)}",
            where=Origin(name, node.line),
            help="Zenoh refuses it at start",
            code="zenoh-configuration",
        ) from None


class _Reading:
    """Turns a valid document into data.

    Args:
        root: the document.
        name: path of the file.
    """

    def __init__(self, root: Node, name: str) -> None:
        self._name = name
        self._found: dict[str, Node] = {}
        self._other: dict[str, Any] = {}
        self._places: dict[str, Origin] = {}
        self._collect("", root)

    def _collect(self, path: str, node: Node) -> None:
        for key, member in node.value.items():
            inner = f"{path}{key}"
            self._places[inner] = Origin(self._name, member.line)
            if "/" in key:  # no setting of Zenoh, but it would read like the path of one
                self._other[f"{path}{quoted(key)}"] = member.plain()
            elif inner in _MODELLED:
                self._found[inner] = member
            elif isinstance(member.value, dict) and (member.value or inner in _AROUND_MODELLED):
                self._collect(f"{inner}/", member)
            else:  # also {} and null: the name alone says which plugin to load
                self._other[inner] = member.plain()

    def configuration(self) -> Configuration:
        """Return the configuration.

        Raises:
            KeymintError: an id of the access control is not known, or occurs twice.
        """
        mode = self._in_mode("mode", "") or "peer"
        own: dict[str, Any] = {"listen": DEFAULT_LISTEN[mode]}
        for path, attribute in SETTINGS.items():
            value = self._in_mode(path, mode)
            if value is not None:
                own[attribute] = tuple(value) if isinstance(value, list) else value
        return Configuration(**own, access_control=self._access_control(), other=self._other, places=self._places)

    def _in_mode(self, path: str, mode: str) -> Any:
        """Return a setting that may have one value for all modes, or one for each; None if it has none."""
        node = self._found.get(path)
        value = None if node is None else node.plain()
        return value.get(mode) if isinstance(value, dict) else value

    def _access_control(self) -> AccessControl:
        node = self._found.get("access_control")
        if node is None:
            return AccessControl(enabled=False, default_permission=Permission.DENY)
        members = node.value
        control = AccessControl(
            enabled=_value(members, "enabled", False),
            default_permission=Permission(_value(members, "default_permission", "deny")),
            rules=tuple(self._rule(item) for item in _items(members, "rules")),
            subjects=tuple(self._subject(item) for item in _items(members, "subjects")),
            policies=tuple(self._policy(item) for item in _items(members, "policies")),
            where=Origin(self._name, node.line),
        )
        missing = [key for key in _LISTS if key not in members or members[key].value is None]
        if control.enabled and missing:
            raise KeymintError(
                f"the access control has no {' and no '.join(missing)}",
                where=control.where,
                help="Zenoh refuses it at start: give all three lists",
                code="zenoh-configuration",
            )
        if defects := [*self._ids(control, members), *self._key_exprs(control)]:
            raise KeymintError.of(defects)
        return control

    def _rule(self, node: Node) -> AclRule:
        members = node.value
        return AclRule(
            id=members["id"].value,
            messages=tuple(map(Message, _texts(members, "messages"))),
            flows=tuple(map(Flow, _texts(members, "flows"))) or (Flow.EGRESS, Flow.INGRESS),
            permission=Permission(members["permission"].value),
            key_exprs=_texts(members, "key_exprs"),
            where=Origin(self._name, node.line),
        )

    def _subject(self, node: Node) -> AclSubject:
        members = node.value
        properties = {attribute: _texts(members, name) for name, attribute in PROPERTIES.items()}
        return AclSubject(members["id"].value, **properties, where=Origin(self._name, node.line))

    def _policy(self, node: Node) -> AclPolicy:
        members = node.value
        return AclPolicy(_texts(members, "rules"), _texts(members, "subjects"), Origin(self._name, node.line))

    def _ids(self, control: AccessControl, members: Mapping[str, Node]) -> Iterator[Diagnostic]:
        """Yield ids that occur twice and ids that nothing has; Zenoh refuses both at start."""
        known: dict[str, set[str]] = {}
        for key, kind in _LISTS.items():
            own = known[kind] = set()
            for item in _items(members, key):
                name = _value(item.value, "id", None)
                if name is None:
                    continue  # a policy need not have one
                if name in own:
                    where = Origin(self._name, item.line)
                    yield self._defect(f"the {kind} {quoted(name)} occurs twice", where, "give each its own id")
                own.add(name)
        for policy in control.policies:
            for kind, names in (("rule", policy.rules), ("subject", policy.subjects)):
                for unknown in dict.fromkeys(names):
                    if unknown not in known[kind]:
                        help_ = did_you_mean(unknown, known[kind], f"declare the {kind}, or remove its id")
                        yield self._defect(f"there is no {kind} {quoted(unknown)}", policy.where, help_)

    def _key_exprs(self, control: AccessControl) -> Iterator[Diagnostic]:
        """Yield the key expressions that are illegal or not canonical; Zenoh refuses them at start."""
        for rule in control.rules:
            for text in rule.key_exprs:
                try:
                    keyexpr.parse(text)
                except keyexpr.KeyExprError as error:
                    yield self._defect(str(error), rule.where, "Zenoh refuses it at start")

    @staticmethod
    def _defect(message: str, where: Origin | None, help_: str) -> Diagnostic:
        return Diagnostic.error("zenoh-configuration", message, where, help_)


def _items(members: Mapping[str, Node], key: str) -> Sequence[Node]:
    items: Sequence[Node] = _value(members, key, ())
    return items


def _texts(members: Mapping[str, Node], key: str) -> tuple[str, ...]:
    return tuple(item.value for item in _items(members, key))


def _value(members: Mapping[str, Node], key: str, default: Any) -> Any:
    node = members.get(key)
    return default if node is None or node.value is None else node.value
