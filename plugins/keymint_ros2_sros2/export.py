# SPDX-License-Identifier: Apache-2.0
"""Export rules as a policy of SROS2: exact, or refused; what is dropped on request only ever allowed something.

The names that express a rule all begin with ``/``, so that nothing is resolved.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from types import MappingProxyType

from comarmor.patterns import glob
from comarmor.patterns.expression import exact, matches
from comarmor.patterns.glob import Glob, matches as matching
from comarmor.rules import PARTS, Effect, Rule, is_subject
from comarmor.text import lazy_regex, quote
from comarmor.values import replace
from keymint.api import ExportedPolicy, ImportedSubject
from keymint.api.xml_templates import xml_document
from keymint.errors import Diagnostic, Origin, Severity, UnsayableError, require_none
from keymint.ir import SubjectRules
from keymint_ros2_sros2 import syntax
from keymint_ros2_sros2.deviations import permissions_document, subject_name

_TAGS = {kind: tag for tag, kind in syntax.KINDS.items()}
_RAW = syntax.PERMISSIONS["topics"]
_PREFIX = "rt"
"""What stands before the names of ROS topics in the names of DDS topics."""
_SERVICES = ("rq/", "rr/")
"""What the names of the DDS topics of services begin with."""
_REQUEST = lazy_regex(r"rq(/.*)Request", re.DOTALL)
_MEMBERS = " \"#$%&'()*+,-./:;<=>?@_`{|}~"
"""Members of a set that need no escape."""
_LITERAL = str.maketrans({char: f"[{char}]" for char in "*?["})


_Name = tuple[str, str, str]
"""The list of a name (``topics``, ``services`` or ``actions``), what its attribute means for ComArmor, and the name."""


def expressed_names(rule: Rule, permission: str, expression: str) -> Iterator[_Name]:
    """Yield the names that say exactly what a rule says of one permission and one expression.

    Raises:
        UnsayableError: there are none.
    """
    relays = permission.endswith("relay")
    if rule.effect is Effect.DENY:
        # What no policy of SROS2 allows needs no denial: to relay, and other than default partitions.
        if relays or (rule.partitions and not any(matches(each, "") for each in rule.partitions)):
            return
    elif rule.partitions not in {(), ("",)}:
        raise UnsayableError("SROS2 has no partitions")
    elif relays:
        raise UnsayableError("SROS2 cannot allow to relay")
    pattern = glob.parse(expression)
    if rule.kind == "topic":
        yield from _raw(rule.effect, permission, pattern)
        return
    parts = PARTS.get((rule.kind, permission))
    if parts is None or (rule.kind in _TAGS and glob.prefix(pattern).startswith("/")):
        yield from ((_TAGS[rule.kind], permission, text) for text in _names(pattern, ""))
        return
    for kind, part, suffix in parts:
        yield from ((_TAGS[kind], part, text) for text in _names(pattern, suffix))


def services(rules: Iterable[Rule]) -> Mapping[tuple[Effect, str, str], tuple[_Name, ...]]:
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
        for permission, expression in product(rule.permissions, rule.expressions)
    }
    found: dict[tuple[Effect, str, str], tuple[_Name, ...]] = {}
    for effect, permission, expression in raw:
        match = _REQUEST.fullmatch(expression)
        back = "subscribe" if permission == "publish" else "publish"
        reply = (effect, back, f"rr{match[1]}Reply") if match else None
        if match and permission in _RAW and reply in raw:
            means = "ros_call" if permission == "publish" else "ros_execute"
            try:
                names = tuple(("services", means, text) for text in _names(glob.parse(match[1]), ""))
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
    return rule.effect is Effect.ALLOW and is_raw(rule) and permission in _RAW and expression == syntax.GRAPH_TOPIC


def _raw(effect: Effect, permission: str, pattern: Glob) -> Iterator[_Name]:
    """Yield the ROS topics whose DDS topics a raw rule names, if it names no others that a policy of SROS2 allows."""
    if effect is Effect.ALLOW and not glob.prefix(pattern).startswith(f"{_PREFIX}/"):
        raise UnsayableError("SROS2 has no rules on DDS topics that are not those of ROS topics")
    if matching(pattern, syntax.GRAPH_TOPIC):
        raise UnsayableError("SROS2 allows the topic of the graph by itself")
    if any(glob.left_quotient(pattern, prefix) for prefix in _SERVICES):
        raise UnsayableError("SROS2 has no rules on DDS topics of services")
    for rest in glob.left_quotient(pattern, f"{_PREFIX}/"):
        yield ("topics", _RAW[permission], _text(glob.surround("/", rest, "")))


def _names(pattern: Glob, suffix: str) -> Iterator[str]:
    """Yield expressions of the names that begin with ``/`` and that a pattern with a suffix matches."""
    for rest in glob.left_quotient(glob.surround("", pattern, suffix), "/"):
        if not glob.is_empty(rest):
            yield _text(glob.surround("/", rest, ""))


def _text(pattern: Glob) -> str:
    """Return the expression of a pattern without escapes, which vendors read differently."""
    text = "".join(
        token.translate(_LITERAL) if isinstance(token, str) else exact((token,), unescaped=_MEMBERS)
        for token in pattern
    )
    if "\\" in text:
        raise UnsayableError("its expression needs a '\\', which vendors read differently")
    if text != text.strip():
        raise UnsayableError("the name ends with white space")
    return text


_LONGEST = 64
"""Characters of a common name (RFC 5280, ub-common-name); SROS2 puts the path there."""
_ROOT_NODE = "root"
"""Name of the node that has the rules of the root enclave, whose path has no last part. It decides nothing."""


def export_policy(subjects: Sequence[SubjectRules], *, lossy: bool = False) -> ExportedPolicy:
    """Return a policy of SROS2; see :meth:`keymint.api.PolicyType.exported`.

    Raises:
        KeymintError: something cannot be said; every such rule with its ``file:line``.
    """
    found: list[Diagnostic] = []
    enclaves = [_enclave(each, found, lossy=lossy) for each in subjects]
    require_none(dict.fromkeys(each for each in found if each.severity is Severity.ERROR))
    made = tuple(
        ImportedSubject(kept, permissions_document(enclave, graph=graph), subject_name(enclave))
        for enclave, kept, graph in enclaves
    )
    written = [enclave for enclave, *_ in enclaves]
    template = Path(__file__).with_name("policy.xml.j2")
    document = xml_document(template, enclaves=written, version=syntax.NEW, permissions=syntax.PERMISSIONS)
    return ExportedPolicy(document, tuple(dict.fromkeys(found)), made)


def _enclave(
    subject: SubjectRules, found: list[Diagnostic], *, lossy: bool
) -> tuple[syntax.Sros2Enclave, SubjectRules, bool]:
    """Return the enclave of a subject, with one node of the same name, and with full names.

    And the rules that are said, and whether they allow the topic of the graph, which SROS2 allows by itself.

    Args:
        subject: the rules of the subject.
        found: gets what cannot be said, what is left out, and what SROS2 adds.
        lossy: leave out what only allows something.
    """
    path = subject.subject
    where = subject.rules[0].origin if subject.rules else Origin("policy.xml")
    if not is_subject(path) or len(path) > _LONGEST:
        message = f"the subject {quote(path)} is no path of an enclave of at most {_LONGEST} characters"
        found.append(Diagnostic.error("sros2-path", message, where, "rename it", path))
    lists: list[syntax.RuleList] = []
    kept: list[Rule] = []
    graph: set[str] = set()
    pairs = services(subject.rules)
    for rule in subject.rules:
        if rule.audit:
            message = f"SROS2 cannot require that a request is logged, as this {rule.effect} {rule.kind} rule does"
            help_ = "with --lossy the rule stays, without AUDIT"
            found.append(_lost("sros2-audit", message, rule, path, help_, lossy=lossy))
        names: dict[_Name, None] = {}
        for permission, expression in product(rule.permissions, rule.expressions):
            try:
                if is_graph(rule, permission, expression):
                    graph.add(permission)
                elif is_raw(rule) and (rule.effect, permission, expression) in pairs:
                    names |= dict.fromkeys(pairs[rule.effect, permission, expression])
                else:
                    names |= dict.fromkeys(expressed_names(rule, permission, expression))
            except UnsayableError as error:
                message = f"SROS2 cannot say {rule.effect} {permission} {quote(expression)}: {error}"
                found.append(_unsayable(message, rule, path, lossy=lossy))
                continue
            kept.append(replace(rule, permissions=(permission,), expressions=(expression,)))
        lists += _lists(rule, names)
    allows_graph = graph == {"publish", "subscribe"}
    if not allows_graph:
        message = f"SROS2 allows {path} to publish and subscribe to ros_discovery_info by itself"
        help_ = "participants need it: include common/node/graph.xml"
        found.append(Diagnostic.warning("sros2-graph", message, where, help_, path))
    parent, _, name = path.rpartition("/")
    node = syntax.RosNode(parent or "/", name or _ROOT_NODE, tuple(lists), where)
    enclave = syntax.Sros2Enclave(path, (syntax.NodeGroup((node,), where),), where)
    return enclave, SubjectRules(path, tuple(kept)), allows_graph


def _unsayable(message: str, rule: Rule, path: str, *, lossy: bool) -> Diagnostic:
    help_ = "--lossy leaves it out: then less is allowed"
    if rule.effect is Effect.DENY:
        help_ = "without it more would be allowed, so --lossy does not drop it either: write the policy without it"
    return _lost("sros2-unsayable", message, rule, path, help_, lossy=lossy and rule.effect is Effect.ALLOW)


def _lost(code: str, message: str, rule: Rule, path: str, help_: str, *, lossy: bool) -> Diagnostic:
    severity, help_ = (Severity.WARNING, "left out (--lossy)") if lossy else (Severity.ERROR, help_)
    return Diagnostic(code, severity, message, rule.origin, help_, path)


def _lists(rule: Rule, names: dict[_Name, None]) -> list[syntax.RuleList]:
    """Return the lists of a rule: one for each tag and set of permissions."""
    by_name: dict[tuple[str, str], list[str]] = {}
    for tag, permission, text in names:
        by_name.setdefault((tag, text), []).append(permission)
    groups: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for (tag, text), given in by_name.items():
        groups.setdefault((tag, tuple(given)), []).append(text)
    return [
        syntax.RuleList(
            tag, MappingProxyType(dict.fromkeys(given, rule.effect)),
            tuple(syntax.Entry(text, rule.origin) for text in texts), rule.origin,
        )
        for (tag, given), texts in groups.items()
    ]  # fmt: skip
