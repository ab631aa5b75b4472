# SPDX-License-Identifier: Apache-2.0
"""The names in a policy of SROS2 that express a rule: all begin with ``/``, so that nothing is resolved."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping

from comarmor.patterns import glob
from comarmor.patterns.expression import exact, matches
from comarmor.patterns.glob import Glob
from comarmor.patterns.glob import matches as matching
from comarmor.regex import lazy_regex
from comarmor.rules import PARTS, Effect, Rule
from comarmor.values import dataclass
from keymint.errors import UnsayableError
from keymint_ros2_sros2.rules import GRAPH_TOPIC
from keymint_ros2_sros2.syntax import KINDS, PERMISSIONS

_TAGS = {kind: tag for tag, kind in KINDS.items()}
_RAW = PERMISSIONS["topics"]
_PREFIX = "rt"
"""What stands before the names of ROS topics in the names of DDS topics."""
_SERVICES = ("rq/", "rr/")
"""What the names of the DDS topics of services begin with."""
_REQUEST = lazy_regex(r"rq(/.*)Request", re.DOTALL)
_MEMBERS = " \"#$%&'()*+,-./:;<=>?@_`{|}~"
"""Members of a set that need no escape."""
_SPECIAL = "*?["


@dataclass(frozen=True, slots=True)
class PolicyName:
    """A name in a list.

    Attributes:
        tag: the list: ``topics``, ``services`` or ``actions``.
        permission: what its attribute means, as ComArmor calls it.
        text: the name.
    """

    tag: str
    permission: str
    text: str


def expressed_names(rule: Rule, permission: str, expression: str) -> Iterator[PolicyName]:
    """Yield the names that say exactly what a rule says of one permission and one expression.

    Raises:
        UnsayableError: there are none.
    """
    if _denies_nothing(rule, permission):
        return
    if rule.effect is Effect.ALLOW and rule.partitions not in {(), ("",)}:
        raise UnsayableError("SROS2 has no partitions")
    if permission.endswith("relay"):
        raise UnsayableError("SROS2 cannot allow to relay")
    pattern = glob.parse(expression)
    if rule.kind == "topic":
        yield from _raw(rule.effect, permission, pattern)
        return
    parts = PARTS.get((rule.kind, permission))
    if parts is None or (rule.kind in _TAGS and glob.prefix(pattern).startswith("/")):
        yield from (PolicyName(_TAGS[rule.kind], permission, text) for text in _names(pattern, ""))
        return
    for kind, part, suffix in parts:
        yield from (PolicyName(_TAGS[kind], part, text) for text in _names(pattern, suffix))


def services(rules: Iterable[Rule]) -> Mapping[tuple[Effect, str, str], tuple[PolicyName, ...]]:
    """Return what raw rules say whose DDS topics are together those of a service (``rq/sRequest`` and ``rr/sReply``).

    Args:
        rules: the rules of a subject.

    Returns:
        By effect, permission and expression of a raw rule: the service for a request, nothing for the reply with it.
        Empty if one of them cannot be said, as the raw rules then cannot.
    """
    raw = {
        (rule.effect, permission, expression)
        for rule in rules
        if is_raw(rule)
        for permission in rule.permissions
        for expression in rule.expressions
    }
    found: dict[tuple[Effect, str, str], tuple[PolicyName, ...]] = {}
    for effect, permission, expression in raw:
        match = _REQUEST.fullmatch(expression)
        back = "subscribe" if permission == "publish" else "publish"
        reply = (effect, back, f"rr{match[1]}Reply") if match else None
        if match and permission in _RAW and reply in raw:
            means = "ros_call" if permission == "publish" else "ros_execute"
            try:
                names = tuple(PolicyName("services", means, text) for text in _names(glob.parse(match[1]), ""))
            except UnsayableError:
                return {}
            found[effect, permission, expression] = names
            found.setdefault(reply, ())
    return found


def is_raw(rule: Rule) -> bool:
    """Tell whether a rule is about DDS topics in the default partition."""
    return rule.kind == "topic" and rule.partitions in {(), ("",)}


def is_graph(rule: Rule, permission: str, expression: str) -> bool:
    """Tell whether SROS2 says it by itself: it allows the topic of the graph."""
    return rule.effect is Effect.ALLOW and is_raw(rule) and permission in _RAW and expression == GRAPH_TOPIC


def _denies_nothing(rule: Rule, permission: str) -> bool:
    """Tell whether a DENY concerns only what no policy of SROS2 allows: to relay, and other than default partitions."""
    if rule.effect is Effect.ALLOW:
        return False
    return permission.endswith("relay") or bool(rule.partitions and not any(matches(p, "") for p in rule.partitions))


def _raw(effect: Effect, permission: str, pattern: Glob) -> Iterator[PolicyName]:
    """Yield the ROS topics whose DDS topics a raw rule names, if it names no others that a policy of SROS2 allows."""
    if effect is Effect.ALLOW and not glob.prefix(pattern).startswith(f"{_PREFIX}/"):
        raise UnsayableError("SROS2 has no rules on DDS topics that are not those of ROS topics")
    if matching(pattern, GRAPH_TOPIC):
        raise UnsayableError("SROS2 allows the topic of the graph by itself")
    if any(glob.left_quotient(pattern, prefix) for prefix in _SERVICES):
        raise UnsayableError("SROS2 has no rules on DDS topics of services")
    for rest in glob.left_quotient(pattern, f"{_PREFIX}/"):
        yield PolicyName("topics", _RAW[permission], _text(glob.surround("/", rest, "")))


def _names(pattern: Glob, suffix: str) -> Iterator[str]:
    """Yield expressions of the names that begin with ``/`` and that a pattern with a suffix matches."""
    for rest in glob.left_quotient(glob.surround("", pattern, suffix), "/"):
        if not glob.is_empty(rest):
            yield _text(glob.surround("/", rest, ""))


def _text(pattern: Glob) -> str:
    """Return the expression of a pattern without escapes, which vendors read differently."""
    parts = (_literal(token) if isinstance(token, str) else exact((token,), unescaped=_MEMBERS) for token in pattern)
    text = "".join(parts)
    if "\\" in text:
        raise UnsayableError("its expression needs a '\\', which vendors read differently")
    if text != text.strip():
        raise UnsayableError("the name ends with white space")
    return text


def _literal(text: str) -> str:
    return "".join(f"[{char}]" if char in _SPECIAL else char for char in text)
