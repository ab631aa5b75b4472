# SPDX-License-Identifier: Apache-2.0
"""Validates XML against XSDs; :mod:`~comarmor.xml.schema_violations` explains what is not valid."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from lxml import etree

from comarmor.data import locate
from comarmor.errors import ComArmorError, Origin


@lru_cache
def _compiled(owner: str, name: str) -> etree.XMLSchema:
    return etree.XMLSchema(file=str(_path(owner, name)))


def _path(owner: str, name: str) -> Path:
    return locate(owner, "schemas") / f"{name}.xsd"


def validate(
    root: etree._Element,
    owner: str,
    name: str,
    file: str,
    chain: tuple[Origin, ...] = (),
    among: tuple[str, str] | None = None,
) -> None:
    """Validate a document against a schema.

    Args:
        root: root element, from :func:`comarmor.xml.reader.parse`.
        owner: package that owns the schema, e.g. ``keymint_ros``.
        name: name of the XSD in ``schemas/<owner>/``, without its suffix.
        file: path of the document as the user would type it.
        chain: the places that include the document, innermost first.
        among: an XSD that includes this one and others, which are compiled together once, and the name of the root
            element that only this one declares.

    Raises:
        ComArmorError: the document is not valid; every defect with ``file:line``, what was expected, and a hint.
    """
    if among and root.tag == among[1] and _compiled(owner, among[0]).validate(root):
        return
    compiled = _compiled(owner, name)
    if compiled.validate(root):
        return
    from comarmor.xml.schema_violations import explained_violations  # noqa: PLC0415 - only messages of errors need it

    raise ComArmorError.of(explained_violations(root, compiled.error_log, _path(owner, name), file, chain))
