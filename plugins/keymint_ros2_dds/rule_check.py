# SPDX-License-Identifier: Apache-2.0
"""Check the rules of a subject alone: what cannot be compiled portably or compiles to nothing, and what cannot start.

DDS Security refuses an endpoint when it is created, and rcl then creates no node. What a node with default options
asks for was measured on Humble and Jazzy, on Cyclone DDS and Fast DDS; their families reach back to Foxy. A node's
options can switch most of it off, and an enclave need not have a node, so that is never more than a note.
"""

from __future__ import annotations

import string
from collections.abc import Iterable, Iterator, Mapping

from comarmor.patterns.decision_lists import Block, DecisionList, Equal, SearchBudget, Universe, Witness
from comarmor.patterns.evaluate import permits
from comarmor.patterns.glob import Glob, left_quotient, parse, right_quotient
from comarmor.patterns.proofs import difference, escapes
from comarmor.patterns.tokens import charset
from comarmor.rules import PARTS
from keymint.api import BuildOptions
from keymint.errors import Diagnostic, KeymintError
from keymint.ir import SubjectRules
from keymint_ros2_dds.build import build
from keymint_ros2_dds.lowering.lowered_rules import lower
from keymint_ros2_dds.lowering.name_mapping import DDS_TOPICS, DISTROS
from keymint_ros2_dds.proving.document_lists import of_policy
from keymint_ros2_dds.proving.questions import deciding_rule
from keymint_ros2_dds.settings import package_of

_RELAYS = ("relay", "ros_relay")


def check_rules(rules: SubjectRules, distro: str) -> tuple[Diagnostic, ...]:
    """Return findings on the rules of a subject: see :meth:`keymint.api.BuildType.check_rules`."""
    try:
        built = build(package_of(rules, distro), BuildOptions()).diagnostics
    except KeymintError as error:
        built = error.diagnostics
    places = {rule.origin.spot for rule in rules.rules}
    of_rules = (each for each in built if each.where is not None and each.where.spot in places)
    return (*_relay_only(rules), *of_rules)


def _relay_only(rules: SubjectRules) -> Iterator[Diagnostic]:
    for rule in rules.rules:
        if rule.permissions and all(permission in _RELAYS for permission in rule.permissions):
            message = f"this {rule.effect} {rule.kind} rule only concerns relaying, which no DDS vendor enforces"
            help_ = "control who may publish and subscribe instead"
            yield Diagnostic.warning("portability-relay", message, rule.origin, help_, rules.subject)


_ALWAYS = (
    ("publish ros_discovery_info", "publish", "ros_discovery_info"),
    ("subscribe ros_discovery_info", "subscribe", "ros_discovery_info"),
    ("publish /rosout", "publish", "rt/rosout"),
    ("publish /parameter_events", "publish", "rt/parameter_events"),
    ("subscribe /parameter_events (rclcpp)", "subscribe", "rt/parameter_events"),
)
"""What each node creates: in words, and as action and DDS topic."""
_TYPES = "/get_type_description"
"""The service that each node has from Iron on; rcl creates no node without it."""
_ROS = Universe(charset((ord(char), ord(char)) for char in f"{string.ascii_letters}{string.digits}_/"))
_NAMES: DecisionList = (Block(True, (parse("/?*"),)),)
_BUDGET = SearchBudget(states=2_000)
"""What a question may cost; one that costs more gets no note."""
_Lists = Mapping[str, DecisionList]
"""The DDS topics that a subject may use, by action."""


def check_node(rules: SubjectRules, distro: str) -> Iterator[Diagnostic]:
    """Yield notes on what cannot start; see :meth:`keymint.api.BuildType.check_node`."""
    known = [*DISTROS]  # the oldest first
    if known.index(distro) < known.index("foxy"):
        return  # not measured
    try:
        lowered = lower(rules, distro)
    except KeymintError:  # whoever compiles the rules reports it
        return
    lists = {action: of_policy(lowered, action, pairs=False) for action in ("publish", "subscribe")}
    release = distro.capitalize()
    missing = [words for words, action, topic in _ALWAYS if not permits(lists[action], topic)]
    if known.index(distro) >= known.index("iron") and not _may_serve(lists, _TYPES, rules.subject):
        missing.append(f"serve any …{_TYPES}")
    if missing:
        message = f"a node of this subject cannot start on {release} with its default options: it may not "
        help_ = "include common/node.xml, unless it has no node, or one whose options switch these off"
        if missing[-1].startswith("serve") and (node := _other_node(lists, rules.subject)):
            help_ = f"allow ros_execute on {node}{_TYPES}: common/node.xml has that for a node {rules.subject} only"
        yield Diagnostic.note("node-cannot-start", message + ", ".join(missing), None, help_, rules.subject)
    if (server := _read_only(lists)) is not None:
        message = (
            f"a client of parameters (rclpy, rclcpp, 'ros2 param') cannot start on {release}: it makes clients of all "
            f"six services, and this subject may read parameters, but not set them, e.g. those of {server}"
        )
        allowing = deciding_rule(rules, distro, "publish", f"rq{server}/get_parametersRequest", "")
        help_ = "add ros_write; or read with a plain client of the service get_parameters"
        where = allowing.origin if allowing else None
        yield Diagnostic.note("parameter-client-cannot-start", message, where, help_, rules.subject)


def _may_serve(lists: _Lists, service: str, subject: str) -> bool:
    """Tell whether there is a node whose service of this name may be served; True if that is too hard to find out."""
    topics = DDS_TOPICS["ros_execute"]
    if all(permits(lists[each.action], each.prefix + subject + service + each.suffix) for each in topics):
        return True  # mostly it is that of the subject's own name
    needed = dict.fromkeys(_servers(lists, (("ros_service", "ros_execute", service),)))
    return not isinstance(difference((), *needed, _NAMES, universe=_ROS, budget=_BUDGET), Equal)


def _other_node(lists: _Lists, subject: str) -> str | None:
    """Return a node of another name than the subject that serves its parameters; None if the subject's own does so."""
    serving = tuple(dict.fromkeys(_servers(lists, (("ros_service", "ros_execute", "/get_parameters"),))))
    own = Block(True, (parse(subject),))
    if all(permits(each, subject) for each in serving):
        return None
    found = escapes((*serving, _NAMES), (own,), _ROS, _BUDGET)
    return found.word if isinstance(found, Witness) else None


def _read_only(lists: _Lists) -> str | None:
    """Return a node whose parameters may be read but not set; None if there is none, or it is too hard to find."""
    first, *others = PARTS["ros_parameter", "ros_read"]
    if not any(block.allows and block.patterns for block in next(_servers(lists, (first,)))):
        return None  # most subjects are no clients of parameters
    reading = tuple(dict.fromkeys(_servers(lists, (first, *others))))
    for needed in dict.fromkeys(_servers(lists, PARTS["ros_parameter", "ros_write"])):
        found = Equal() if needed in reading else escapes((*reading, _NAMES), needed, _ROS, _BUDGET)
        if isinstance(found, Witness):
            return found.word
    return None


def _servers(lists: _Lists, services: Iterable[tuple[str, str, str]]) -> Iterator[DecisionList]:
    """Yield lists that together permit the nodes on all of whose services a subject has a permission.

    Most are equal: the rules of parameters are about all their services.

    Args:
        lists: the DDS topics that it may use.
        services: kind, permission and name of each service, as in :data:`comarmor.rules.PARTS`.
    """
    for _, permission, name in services:
        for topic in DDS_TOPICS[permission]:
            yield _stripped(lists[topic.action], topic.prefix, name + topic.suffix)


def _stripped(decisions: DecisionList, start: str, end: str) -> DecisionList:
    """Return the list of the texts on which a list decides with a start and an end around them."""

    def inner(pattern: Glob) -> Iterator[Glob]:
        return (text for rest in right_quotient(pattern, end) for text in left_quotient(rest, start))

    return tuple(Block(each.allows, tuple(text for one in each.patterns for text in inner(one))) for each in decisions)
