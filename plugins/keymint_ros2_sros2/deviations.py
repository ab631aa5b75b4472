# SPDX-License-Identifier: Apache-2.0
"""What SROS2 enforces differently from what a policy says, and what no keystore can hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from comarmor.errors import ComArmorError, Diagnostic
from comarmor.ros_names import is_subject
from comarmor.text import quoted
from comarmor.values import dataclass
from keymint_ros2_sros2.names import as_read, enforced, expression
from keymint_ros2_sros2.syntax import Enclave, Entry, Node, NodeGroup, SourcePolicy

_LONGEST_PATH = 1024
_LONGEST_SEGMENT = 255
"""Characters of a path, which becomes one of files, and of a part of it."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """Something in a policy that needs a decision of its owner.

    Attributes:
        diagnostic: what it is, as an error about an enclave.
        acceptable: it has a meaning as it reads, which ``--accept`` takes.
    """

    diagnostic: Diagnostic
    acceptable: bool


def deviations(policy: SourcePolicy) -> tuple[Deviation, ...]:
    """Return what SROS2 enforces differently from what the policy says, and what cannot be taken over."""
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


def _deviation(
    code: str, message: str, enclave: Enclave, place: Enclave | Entry | Node | NodeGroup, help_: str, *,
    acceptable: bool = True,
) -> Deviation:  # fmt: skip
    return Deviation(Diagnostic.error(code, message, place.where, help_, enclave.path), acceptable)


def _doubled(policy: SourcePolicy) -> Iterator[Deviation]:
    first: dict[str, Enclave] = {}
    for enclave in policy.enclaves:
        before = first.setdefault(enclave.path, enclave)
        if before is not enclave:
            message = (
                f"the enclave {quoted(enclave.path)} stands here and at {before.where.alone()}: generate_artifacts uses"
                " the last one only, create_permission the first"
            )
            help_ = "write one <enclave>; --accept takes all of them together"
            yield _deviation("sros2-path-twice", message, enclave, enclave, help_)


def _of_path(enclave: Enclave) -> Iterator[Deviation]:
    path = enclave.path
    if is_subject(path) and len(path) <= _LONGEST_PATH and max(map(len, path.split("/"))) <= _LONGEST_SEGMENT:
        return
    message = f"{quoted(path)}: not a path of an enclave"
    help_ = (
        "expected '/' and segments of letters, digits and '_' that do not begin with a digit, without wildcards;"
        f" at most {_LONGEST_PATH:,} characters, and {_LONGEST_SEGMENT} between two '/'"
    )
    yield _deviation("sros2-path", message, enclave, enclave, help_, acceptable=False)


def _of_groups(enclave: Enclave) -> Iterator[Deviation]:
    if len(enclave.groups) > 1:
        message = (
            f"the enclave {quoted(enclave.path)} has {len(enclave.groups)} <profiles>: SROS2 writes a grant for each,"
            " and participants use the first only"
        )
        help_ = "put all <profile> into one <profiles>; --accept takes all of them together"
        yield _deviation("sros2-two-profiles", message, enclave, enclave.groups[1], help_)


def _of_node(enclave: Enclave, node: Node) -> Iterator[Deviation]:
    if node.ns and not node.ns.startswith("/"):
        message = f"the namespace {quoted(node.ns)} does not begin with '/': SROS2 writes topics that no node has"
        help_ = f"write ns={quoted('/' + node.ns.strip())}; --accept reads it so"
        yield _deviation("sros2-namespace", message, enclave, node, help_)
    for name, value in (("ns", node.ns), ("node", node.name)):
        if value != value.strip():
            message = f"{name}={quoted(value)} has white space around it, which SROS2 keeps"
            yield _deviation("sros2-padded", message, enclave, node, "remove it; --accept reads it so")


def _of_entry(enclave: Enclave, node: Node, entry: Entry) -> Iterator[Deviation]:
    text, trimmed = entry.text, entry.text.strip()
    if not trimmed:
        help_ = "write a name, or remove the element"
        yield _deviation("sros2-empty", "the name is empty", enclave, entry, help_, acceptable=False)
        return
    try:
        expression(as_read(node, text), entry)
    except ComArmorError as error:
        yield from (Deviation(replace(each, subject=enclave.path), acceptable=False) for each in error.diagnostics)
        return
    if text != trimmed:
        message = f"{quoted(text)} has white space around it, which SROS2 keeps: {_names(node, text)}"
        yield _deviation("sros2-padded", message, enclave, entry, "remove it; --accept reads it so")
    if trimmed.startswith("~") and trimmed[1:2] not in ("", "/"):
        message = f"{quoted(text)} is not a private name, which begins with '~/': {_names(node, text)}"
        help_ = f"write ~/{trimmed[1:]}, or the full name; --accept reads it as ~/{trimmed[1:]}"
        yield _deviation("sros2-tilde", message, enclave, entry, help_)
    if "\\" in text:
        message = f"{quoted(text)} has a '\\', which escapes a character in the standard, and is one for Fast DDS"
        help_ = "no ROS name has a '\\': remove it; --accept reads it as the standard does"
        yield _deviation("sros2-backslash", message, enclave, entry, help_)


def _names(node: Node, text: str) -> str:
    return f"SROS2 enforces {quoted(enforced(node, text))}, not {quoted(as_read(node, text))}"
