"""The settings of a profile that ``keymint init`` takes as options, read back from its files."""

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
    return {"distro": profile.distro, "layout": profile.layout, **_grant_settings(profile)}


def _grant_settings(profile: WorkspaceProfile) -> Mapping[str, str]:
    content = profile.files.get(_GRANT_DEFAULTS)
    return {} if content is None else _read(content, _GRANT_DEFAULTS)


def _settings_of(root: etree._Element) -> Mapping[str, str]:
    domains = governance.domains(root.find("domains")) or ()
    written = text(root.find("subject_name")) or ""
    names = {name: format_ for format_, name in bootstrap.SUBJECT_NAMES.items()}
    shown = (str(each.first) if each.first == each.last else f"{each.first}-{each.last}" for each in domains)
    return {"domain": ", ".join(shown), "subject-format": names.get(written, written)}


_read = Reader("defaults_permissions", _settings_of)
