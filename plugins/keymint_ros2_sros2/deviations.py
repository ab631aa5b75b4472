# SPDX-License-Identifier: Apache-2.0
"""What SROS2 makes of a policy: the permissions document of its stylesheet (sros2 0.13, measured), and what differs.

A document has one grant for each ``<profiles>``, with one ``deny_rule`` if anything is denied, one ``allow_rule``, and
from Foxy on an ``allow_rule`` for the graph. Names are those that it enforces, not those that the policy reads. It
shares no code with the compiler: the two are compared. What SROS2 enforces differently from what a policy says, and
what no keystore can hold, are its deviations.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from comarmor.rules import Effect, is_subject
from comarmor.text import quote
from comarmor.values import replace
from keymint.api.xml_templates import xml_document
from keymint.errors import Diagnostic, KeymintError
from keymint_ros2_sros2 import syntax

_LONGEST_PATH = 1024
_LONGEST_SEGMENT = 255
"""Characters of a path, which becomes one of files, and of a part of it."""


ACCEPTABLE = frozenset((
    "sros2-path-twice", "sros2-two-profiles", "sros2-namespace", "sros2-padded", "sros2-tilde", "sros2-backslash",
))  # fmt: skip
"""The codes of what has a meaning as it reads, which ``--as-written`` takes."""


def deviations(policy: syntax.SourcePolicy) -> tuple[Diagnostic, ...]:
    """Return errors about what SROS2 enforces differently from what the policy says, and what cannot be taken over.

    Each is about an enclave, and needs a decision of the policy's owner.
    """
    found = [*_doubled(policy)]
    for enclave in policy.enclaves:
        found += _of_enclave(enclave)
        for node in enclave.nodes():
            found += _of_node(enclave, node)
            found += (
                each for rules in node.lists for entry in rules.entries for each in _of_entry(enclave, node, entry)
            )
    return tuple(found)


def _doubled(policy: syntax.SourcePolicy) -> Iterator[Diagnostic]:
    first: dict[str, syntax.Sros2Enclave] = {}
    for enclave in policy.enclaves:
        before = first.setdefault(enclave.path, enclave)
        if before is not enclave:
            message = (
                f"the enclave {quote(enclave.path)} stands here and at {before.where.alone()}: generate_artifacts uses"
                " the last one only, create_permission the first"
            )
            help_ = "write one <enclave>; --as-written takes all of them together"
            yield Diagnostic.error("sros2-path-twice", message, enclave.where, help_, enclave.path)


def _of_enclave(enclave: syntax.Sros2Enclave) -> Iterator[Diagnostic]:
    path = enclave.path
    if not is_subject(path) or len(path) > _LONGEST_PATH or max(map(len, path.split("/"))) > _LONGEST_SEGMENT:
        help_ = (
            "expected '/' and segments of letters, digits and '_' that do not begin with a digit, without wildcards;"
            f" at most {_LONGEST_PATH:,} characters, and {_LONGEST_SEGMENT} between two '/'"
        )
        yield Diagnostic.error("sros2-path", f"{quote(path)}: not a path of an enclave", enclave.where, help_, path)
    if len(enclave.groups) > 1:
        message = (
            f"the enclave {quote(path)} has {len(enclave.groups)} <profiles>: SROS2 writes a grant for each,"
            " and participants use the first only"
        )
        help_ = "put all <profile> into one <profiles>; --as-written takes all of them together"
        yield Diagnostic.error("sros2-two-profiles", message, enclave.groups[1].where, help_, path)


def _of_node(enclave: syntax.Sros2Enclave, node: syntax.RosNode) -> Iterator[Diagnostic]:
    if node.ns and not node.ns.startswith("/"):
        message = f"the namespace {quote(node.ns)} does not begin with '/': SROS2 writes topics that no node has"
        help_ = f"write ns={quote('/' + node.ns.strip())}; --as-written reads it so"
        yield Diagnostic.error("sros2-namespace", message, node.where, help_, enclave.path)
    for name, value in (("ns", node.ns), ("node", node.name)):
        if value != value.strip():
            message = f"{name}={quote(value)} has white space around it, which SROS2 keeps"
            yield Diagnostic.error("sros2-padded", message, node.where, "remove it, or --as-written", enclave.path)


def _of_entry(enclave: syntax.Sros2Enclave, node: syntax.RosNode, entry: syntax.Entry) -> Iterator[Diagnostic]:
    text, trimmed = entry.text, entry.text.strip()
    if not trimmed:
        help_ = "write a name, or remove the element"
        yield Diagnostic.error("sros2-empty", "the name is empty", entry.where, help_, enclave.path)
        return
    try:
        syntax.expression(syntax.as_read(node, text), entry)
    except KeymintError as error:
        yield from (replace(each, subject=enclave.path) for each in error.diagnostics)
        return
    if text != trimmed:
        message = f"{quote(text)} has white space around it, which SROS2 keeps: {_names(node, text)}"
        yield Diagnostic.error("sros2-padded", message, entry.where, "remove it, or --as-written", enclave.path)
    if trimmed.startswith("~") and trimmed[1:2] not in ("", "/"):
        message = f"{quote(text)} is not a private name, which begins with '~/': {_names(node, text)}"
        help_ = f"write ~/{trimmed[1:]}, or the full name; --as-written reads it as ~/{trimmed[1:]}"
        yield Diagnostic.error("sros2-tilde", message, entry.where, help_, enclave.path)
    if "\\" in text:
        message = f"{quote(text)} has a '\\', which escapes a character in the standard, and is one for Fast DDS"
        help_ = "no ROS name has a '\\': remove it; --as-written reads it as the standard does"
        yield Diagnostic.error("sros2-backslash", message, entry.where, help_, enclave.path)


def _names(node: syntax.RosNode, text: str) -> str:
    return f"SROS2 enforces {quote(syntax.enforced_name(node, text))}, not {quote(syntax.as_read(node, text))}"


_REQUESTS = tuple(f"/_action/{name}Request" for name in ("cancel_goal", "get_result", "send_goal"))
_REPLIES = tuple(f"/_action/{name}Reply" for name in ("cancel_goal", "get_result", "send_goal"))
_TOPICS = tuple(f"/_action/{name}" for name in ("feedback", "status"))
_PARTS = {
    "ros_publish": (("publish", "rt", ("",)),),
    "ros_subscribe": (("subscribe", "rt", ("",)),),
    "ros_call": (("publish", "rq", ("Request",)), ("subscribe", "rr", ("Reply",))),
    "ros_execute": (("subscribe", "rq", ("Request",)), ("publish", "rr", ("Reply",))),
    "ros_request": (("publish", "rq", _REQUESTS), ("subscribe", "rr", _REPLIES), ("subscribe", "rt", _TOPICS)),
    "ros_operate": (("subscribe", "rq", _REQUESTS), ("publish", "rr", _REPLIES), ("publish", "rt", _TOPICS)),
}
"""What a permission on a name lets do, and the DDS topics: what stands before the name, and what may stand after it."""

_Topic = tuple[str, str]
"""What may be done, and the DDS topic."""


def subject_name(enclave: syntax.Sros2Enclave) -> str:
    """Return the subject name of an enclave's certificate and grants."""
    return f"CN={enclave.path}"


def permissions_document(enclave: syntax.Sros2Enclave, *, graph: bool) -> bytes:
    """Return the permissions document that SROS2 writes for an enclave, for domain 0 and any period.

    Args:
        enclave: the enclave.
        graph: as SROS2 does with an RMW that has the graph's topic, from version 0.2.0 on.
    """
    by_itself = [("allow_rule", [(action, syntax.GRAPH_TOPIC) for action in ("publish", "subscribe")])] if graph else []
    effects = {"deny_rule": Effect.DENY, "allow_rule": Effect.ALLOW}
    grants = [
        [*((tag, sorted({*_topics(group, effect)})) for tag, effect in effects.items()), *by_itself]
        for group in enclave.groups
    ]
    template = Path(__file__).with_name("permissions.xml.j2")
    return xml_document(template, path=enclave.path, subject_name=subject_name(enclave), grants=grants)


def _topics(group: syntax.NodeGroup, effect: Effect) -> Iterator[_Topic]:
    for node in group.nodes:
        for rules in node.lists:
            names = [syntax.enforced_name(node, entry.text) for entry in rules.entries]
            for permission, given in rules.effects.items():
                for action, prefix, suffixes in _PARTS[permission] if given is effect else ():
                    yield from ((action, f"{prefix}{name}{suffix}") for name in names for suffix in suffixes)
