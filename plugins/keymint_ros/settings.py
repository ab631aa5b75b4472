"""Reads back from a profile's files the settings that ``keymint init`` takes as options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from keymint.api import WorkspaceProfile
from keymint_ros import bootstrap, governance
from keymint_ros.document import Reader, text

if TYPE_CHECKING:
    from lxml import etree

_GRANT_DEFAULTS = "package.defaults/permissions.xml"


def settings(profile: WorkspaceProfile) -> Mapping[str, str]:
    """Return the value of each option of ``init``: see :meth:`keymint.api.ProfileSettings.settings`."""
    content = profile.files.get(_GRANT_DEFAULTS)
    grant = {} if content is None else _read(content, _GRANT_DEFAULTS)
    return {"distro": profile.distro, "layout": profile.layout, **grant}


def _permissions_defaults(root: etree._Element) -> Mapping[str, str]:
    domains = governance.domains(root.find("domains"))
    subject_name = text(root.find("subject_name")) or ""
    formats = {name: format_ for format_, name in bootstrap.SUBJECT_NAMES.items()}
    ranges = (str(each.first) if each.first == each.last else f"{each.first}-{each.last}" for each in domains)
    return {"domain": ", ".join(ranges), "subject-format": formats.get(subject_name, subject_name)}


_read = Reader("defaults_permissions", _permissions_defaults)
