# SPDX-License-Identifier: Apache-2.0
"""Read a configuration: the only reader, for checks, proofs, the model and real routers.

It refuses what Zenoh refuses at start, and every file that two readers could understand differently.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import fastjsonschema

from comarmor.data import locate
from comarmor.text import did_you_mean, quote
from keymint.errors import Diagnostic, KeymintError, Origin, require_none
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
    document, lines = json5.parse(content, name)
    try:
        _validator()(document)
    except fastjsonschema.JsonSchemaValueException as error:
        path: json5.Path = ()
        for step in error.path[1:]:
            inner = (*path, int(step) if isinstance(document, list) else step)
            if inner not in lines:
                break
            path, document = inner, document[inner[-1]]
        place = "/".join(error.path[1:]) or "the file"
        what = error.message.removeprefix(error.name or "").strip()
        message = f"{quote(place, 200)} {quote(what, 200)}"
        where, help_ = Origin(name, lines[path]), "Zenoh refuses it at start"
        raise KeymintError(message, where=where, help=help_, code="zenoh-configuration") from None
    return _Reading(document, lines, name).configuration()


@lru_cache(maxsize=1)
def _validator() -> Callable[[Any], Any]:
    path = locate("keymint_ros2_zenoh", "schemas") / "configuration.schema.json"
    validator: Callable[[Any], Any] = fastjsonschema.compile(json.loads(path.read_bytes()), use_default=False)
    return validator


class _Reading:
    """Turns a valid document into data.

    Args:
        document: the document.
        lines: the line of each value in it.
        name: path of the file.
    """

    def __init__(self, document: Any, lines: Mapping[json5.Path, int], name: str) -> None:
        self._name = name
        self._lines = lines
        self._found: dict[str, Any] = {}
        self._other: dict[str, Any] = {}
        self._places = {"": Origin(name)}
        self._collect((), document)

    def _place(self, *path: str | int) -> Origin:
        return Origin(self._name, self._lines[path])

    def _collect(self, path: tuple[str, ...], members: Mapping[str, Any]) -> None:
        for key, member in members.items():
            inner = "/".join((*path, key))
            self._places[inner] = self._place(*path, key)
            if "/" in key:  # no setting of Zenoh, but it would read like the path of one
                self._other["/".join((*path, quote(key)))] = member
            elif inner in _MODELLED:
                self._found[inner] = member
            elif isinstance(member, dict) and (member or inner in _AROUND_MODELLED):
                self._collect((*path, key), member)
            else:  # also {} and null: the name alone says which plugin to load
                self._other[inner] = member

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
        value = self._found.get(path)
        return value.get(mode) if isinstance(value, dict) else value

    def _access_control(self) -> AccessControl:
        members = self._found.get("access_control")
        if members is None:
            return AccessControl(enabled=False, default_permission=Permission.DENY)
        control = AccessControl(
            enabled=members.get("enabled") or False,
            default_permission=Permission(members.get("default_permission") or "deny"),
            rules=tuple(self._rule(item, where) for item, where in self._items("rules")),
            subjects=tuple(
                AclSubject(item["id"], **{name: _texts(item, name) for name in PROPERTIES}, where=where)
                for item, where in self._items("subjects")
            ),
            policies=tuple(
                AclPolicy(_texts(item, "rules"), _texts(item, "subjects"), where)
                for item, where in self._items("policies")
            ),
            where=self._place("access_control"),
        )
        missing = [key for key in _LISTS if members.get(key) is None]
        if control.enabled and missing:
            message = f"the access control has no {' and no '.join(missing)}"
            help_ = "Zenoh refuses it at start: give all three lists"
            raise KeymintError(message, where=control.where, help=help_, code="zenoh-configuration")
        require_none([*self._ids(control), *self._key_exprs(control)])
        return control

    def _items(self, key: str) -> Iterator[tuple[Mapping[str, Any], Origin]]:
        """Yield the items of a list of the access control, each with its place."""
        for at, item in enumerate(self._found["access_control"].get(key) or ()):
            yield item, self._place("access_control", key, at)

    @staticmethod
    def _rule(item: Mapping[str, Any], where: Origin) -> AclRule:
        return AclRule(
            id=item["id"],
            messages=tuple(map(Message, _texts(item, "messages"))),
            flows=tuple(map(Flow, _texts(item, "flows"))) or (Flow.EGRESS, Flow.INGRESS),
            permission=Permission(item["permission"]),
            key_exprs=_texts(item, "key_exprs"),
            where=where,
        )

    def _ids(self, control: AccessControl) -> Iterator[Diagnostic]:
        """Yield ids that occur twice and ids that nothing has; Zenoh refuses both at start."""
        known: dict[str, set[str]] = {}
        for key, kind in _LISTS.items():
            own = known[kind] = set()
            for item, where in self._items(key):
                name = item.get("id")
                if name is None:
                    continue  # a policy need not have one
                if name in own:
                    yield self._defect(f"the {kind} {quote(name)} occurs twice", where, "give each its own id")
                own.add(name)
        for policy in control.policies:
            for kind, names in (("rule", policy.rules), ("subject", policy.subjects)):
                for unknown in dict.fromkeys(names):
                    if unknown not in known[kind]:
                        help_ = did_you_mean(unknown, known[kind], f"declare the {kind}, or remove its id")
                        yield self._defect(f"there is no {kind} {quote(unknown)}", policy.where, help_)

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


def _texts(item: Mapping[str, Any], key: str) -> tuple[str, ...]:
    return tuple(item.get(key) or ())
