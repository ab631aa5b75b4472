# SPDX-License-Identifier: Apache-2.0
"""What SROS2 enforces differently from what a policy says, and what no keystore can hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from comarmor.errors import ComArmorError, Diagnostic
from comarmor.rules import is_subject
from comarmor.text import quoted
from keymint_ros2_sros2.syntax import Entry, RosNode, SourcePolicy, Sros2Enclave, as_read, enforced_name, expression

_LONGEST_PATH = 1024
_LONGEST_SEGMENT = 255
"""Characters of a path, which becomes one of files, and of a part of it."""


ACCEPTABLE = frozenset((
    "sros2-path-twice", "sros2-two-profiles", "sros2-namespace", "sros2-padded", "sros2-tilde", "sros2-backslash",
))  # fmt: skip
"""The codes of what has a meaning as it reads, which ``--accept`` takes."""


def deviations(policy: SourcePolicy) -> tuple[Diagnostic, ...]:
    """Return errors about what SROS2 enforces differently from what the policy says, and what cannot be taken over.

    Each is about an enclave, and needs a decision of the policy's owner.
    """
    found = [*_doubled(policy)]
    for enclave in policy.enclaves:
        found += _of_path(enclave)
        found += _of_groups(enclave)
        for node in enclave.nodes():
            found += _of_node(enclave, node)
            found += (
                each for rules in node.lists for entry in rules.entries for each in _of_entry(enclave, node, entry)
            )
    return tuple(found)


def _doubled(policy: SourcePolicy) -> Iterator[Diagnostic]:
    first: dict[str, Sros2Enclave] = {}
    for enclave in policy.enclaves:
        before = first.setdefault(enclave.path, enclave)
        if before is not enclave:
            message = (
                f"the enclave {quoted(enclave.path)} stands here and at {before.where.alone()}: generate_artifacts uses"
                " the last one only, create_permission the first"
            )
            help_ = "write one <enclave>; --accept takes all of them together"
            yield Diagnostic.error("sros2-path-twice", message, enclave.where, help_, enclave.path)


def _of_path(enclave: Sros2Enclave) -> Iterator[Diagnostic]:
    path = enclave.path
    if is_subject(path) and len(path) <= _LONGEST_PATH and max(map(len, path.split("/"))) <= _LONGEST_SEGMENT:
        return
    message = f"{quoted(path)}: not a path of an enclave"
    help_ = (
        "expected '/' and segments of letters, digits and '_' that do not begin with a digit, without wildcards;"
        f" at most {_LONGEST_PATH:,} characters, and {_LONGEST_SEGMENT} between two '/'"
    )
    yield Diagnostic.error("sros2-path", message, enclave.where, help_, enclave.path)


def _of_groups(enclave: Sros2Enclave) -> Iterator[Diagnostic]:
    if len(enclave.groups) > 1:
        message = (
            f"the enclave {quoted(enclave.path)} has {len(enclave.groups)} <profiles>: SROS2 writes a grant for each,"
            " and participants use the first only"
        )
        help_ = "put all <profile> into one <profiles>; --accept takes all of them together"
        yield Diagnostic.error("sros2-two-profiles", message, enclave.groups[1].where, help_, enclave.path)


def _of_node(enclave: Sros2Enclave, node: RosNode) -> Iterator[Diagnostic]:
    if node.ns and not node.ns.startswith("/"):
        message = f"the namespace {quoted(node.ns)} does not begin with '/': SROS2 writes topics that no node has"
        help_ = f"write ns={quoted('/' + node.ns.strip())}; --accept reads it so"
        yield Diagnostic.error("sros2-namespace", message, node.where, help_, enclave.path)
    for name, value in (("ns", node.ns), ("node", node.name)):
        if value != value.strip():
            message = f"{name}={quoted(value)} has white space around it, which SROS2 keeps"
            yield Diagnostic.error("sros2-padded", message, node.where, "remove it; --accept reads it so", enclave.path)


def _of_entry(enclave: Sros2Enclave, node: RosNode, entry: Entry) -> Iterator[Diagnostic]:
    text, trimmed = entry.text, entry.text.strip()
    if not trimmed:
        help_ = "write a name, or remove the element"
        yield Diagnostic.error("sros2-empty", "the name is empty", entry.where, help_, enclave.path)
        return
    try:
        expression(as_read(node, text), entry)
    except ComArmorError as error:
        yield from (replace(each, subject=enclave.path) for each in error.diagnostics)
        return
    if text != trimmed:
        message = f"{quoted(text)} has white space around it, which SROS2 keeps: {_names(node, text)}"
        yield Diagnostic.error("sros2-padded", message, entry.where, "remove it; --accept reads it so", enclave.path)
    if trimmed.startswith("~") and trimmed[1:2] not in ("", "/"):
        message = f"{quoted(text)} is not a private name, which begins with '~/': {_names(node, text)}"
        help_ = f"write ~/{trimmed[1:]}, or the full name; --accept reads it as ~/{trimmed[1:]}"
        yield Diagnostic.error("sros2-tilde", message, entry.where, help_, enclave.path)
    if "\\" in text:
        message = f"{quoted(text)} has a '\\', which escapes a character in the standard, and is one for Fast DDS"
        help_ = "no ROS name has a '\\': remove it; --accept reads it as the standard does"
        yield Diagnostic.error("sros2-backslash", message, entry.where, help_, enclave.path)


def _names(node: RosNode, text: str) -> str:
    return f"SROS2 enforces {quoted(enforced_name(node, text))}, not {quoted(as_read(node, text))}"
