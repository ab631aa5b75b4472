# SPDX-License-Identifier: Apache-2.0
"""The canonical form of ComArmor files (profiles, what they include, and policy tests: ``docs/language.md``).

Also of policies that are rendered as XML: with tunables and includes expanded, in one dialect.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from lxml import etree

from comarmor.errors import ComArmorError, Origin
from comarmor.language.attachments import strip
from comarmor.language.layout import TEXT, laid_out, markup, nodes
from comarmor.language.policy import Policy
from comarmor.language.syntax import Profile, ProfileRule
from comarmor.rules import PERMISSIONS
from comarmor.xml import schema
from comarmor.xml.reader import parse
from comarmor.xml.sandboxed_paths import file_errors, path_text


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


_DECLARATION = '<?xml version="1.0" encoding="UTF-8"?>\n'
_SCHEMAS = dict.fromkeys(("profiles", "profile", *PERMISSIONS), "comarmor") | {"tests": "tests"}
"""The schema of a file by the name of its root element."""


def canonical_form(content: bytes, name: str) -> bytes | None:
    """Return a file in canonical form, or None if its root element is not of this language.

    Formatting it again changes nothing. What the file means stays the same, and all its comments and processing
    instructions are kept in order. Lines end as the first one does.

    Args:
        content: the file.
        name: its path as the user would type it, for messages.

    Raises:
        ComArmorError: it is not well-formed or not valid, with ``file:line`` of each defect. What it includes is not
            read, and its expressions are not checked.
    """
    root = parse(content, name)
    if not _is_of_this_language(root):
        return None
    schema.validate(root, "comarmor", _SCHEMAS[str(root.tag)], name)
    document = nodes(content)
    text = _DECLARATION + laid_out(document)
    first_line = content.partition(b"\n")[0].rstrip(b"\0")  # UTF-16 has a zero byte between the two
    result = (text.replace("\n", "\r\n") if first_line.endswith(b"\r") else text).encode()
    again = nodes(result)
    comments, comments_again = ([each.source.split() for each in markup(which)] for which in (document, again))
    if _meaning(root) != _meaning(parse(result, name)) or comments != comments_again:
        message = "the canonical form would not mean the same"
        help_ = "this is a defect of the formatter; please report it with this file"
        raise ComArmorError(message, where=Origin(name), help=help_, code="format-meaning")
    return result


def _is_of_this_language(root: etree._Element) -> bool:
    """Tell whether a document is meant to be a file of this language, valid or not.

    Files of workspaces have a root ``<profile>`` as well; profiles of this language have a name or attachments.
    """
    if root.tag == "profile":
        return "name" in root.attrib or any(child.tag in ("attachment", "attachments") for child in root)
    return root.tag in _SCHEMAS


def written_files(folder: Path) -> tuple[Path, ...]:
    """Return, sorted, the ``*.xml`` files in a folder and below it, without links and what is hidden.

    These are the policy's root files and tests, and all that they may include from the folder.

    Raises:
        ComArmorError: a folder cannot be read.
    """

    def refuse(error: OSError) -> None:
        with file_errors("the folder", Origin(path_text(str(error.filename)))):
            raise error

    found: list[Path] = []
    for inside, folders, names in os.walk(folder, onerror=refuse):
        folders[:] = (name for name in folders if not name.startswith("."))
        files = (Path(inside, name) for name in names if name.endswith(".xml") and not name.startswith("."))
        found += (file for file in files if file.is_file() and not file.is_symlink())
    return tuple(sorted(found))


def _meaning(element: etree._Element) -> tuple[Any, ...]:
    """Return what a reader of the language sees of an element."""
    text = strip(element.text or "") if element.tag in TEXT else ""
    return element.tag, dict(element.attrib), text, [_meaning(child) for child in element]
