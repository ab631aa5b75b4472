# SPDX-License-Identifier: Apache-2.0
"""Render a policy as XML in canonical form: tunables and includes expanded, one dialect."""

from __future__ import annotations

from lxml import etree

from comarmor.language.policy import Policy
from comarmor.language.syntax import Profile, ProfileRule
from comarmor.rules import PERMISSIONS


def render(policy: Policy) -> str:
    """Return a policy as one XML document without includes and tunables.

    The document decides every request as the policy does. Loading and rendering it again gives the same text.
    """
    root = etree.Element("profiles")
    root.extend(map(profile, policy.profiles))
    return document(root)


def document(root: etree._Element) -> str:
    """Return an element as an XML document in canonical form; see :mod:`comarmor.language.formatting`."""
    etree.indent(root)
    for permissions in root.iter("permissions"):
        permissions.text = None
        for permission in permissions:
            permission.tail = None
    text = etree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def profile(source: Profile) -> etree._Element:
    """Return the element of a profile."""
    element = _attached(etree.Element("profile", name=source.name), source)
    element.extend(map(_rule, source.rules))
    element.extend(map(profile, source.profiles))
    return element


def _attached(element: etree._Element, source: Profile | ProfileRule) -> etree._Element:
    """Return the element of a profile or a rule, with its modifier and attachments."""
    if source.audit:
        element.set("modifier", "AUDIT")
    for attachment in source.attachments:
        etree.SubElement(element, "attachment").text = attachment.text
    return element


def _rule(rule: ProfileRule) -> etree._Element:
    element = _attached(etree.Element(rule.kind, qualifier=rule.effect.value), rule)
    permissions = etree.SubElement(element, "permissions")
    for permission in PERMISSIONS[rule.kind]:
        if permission in rule.permissions:
            etree.SubElement(permissions, permission)
    if rule.partitions:
        partitions = etree.SubElement(element, "partitions")
        for partition in rule.partitions:
            etree.SubElement(partitions, "partition").text = partition
    return element
