# SPDX-License-Identifier: Apache-2.0
"""Edits of the profile as text, so that comments and layout stay: a setting of ``keymint init`` gets another value.

Only the text of the elements that change is replaced. What is written in another way than Keymint writes it stays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime

from comarmor.text import lazy_regex
from keymint.api import WorkspaceProfile
from keymint_ros import bootstrap, distros, validity
from keymint_ros.package_writer import without_comments
from keymint_ros.profile_reader import MANIFEST

_DISTRO = lazy_regex(r"<distro\s*>\s*([^<]*?)\s*</distro\s*>")
_DOMAIN = lazy_regex(r"<domains\s*>\s*<id\s*>\s*([^<]*?)\s*</id\s*>\s*</domains\s*>")
_SUBJECT_NAME = lazy_regex(r"<subject_name\s*>\s*([^<]*?)\s*</subject_name\s*>")
_BEGIN = lazy_regex(r"<validity\s*>\s*<not_before\s*>\s*([^<]*?)\s*</not_before")
_END = lazy_regex(r"<validity\s*>.*?(<(not_after|duration)\s*>[^<]*</\2\s*>)", re.DOTALL)
_PERMISSIONS, _IDENTITIES = "package.defaults/permissions.xml", "package.defaults/identities.xml"


def with_setting(profile: WorkspaceProfile, name: str, value: str, now: datetime) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.ProfileType.with_setting`."""
    places, edits = _edits_of(name, value, now)
    changed: dict[str, bytes] = {}
    for path in places:
        text, plain = without_comments(profile.files.get(path, b""))
        found = [(*match.span(1), new) for pattern, new in edits.items() if (match := pattern.search(plain))]
        for begin, end, new in sorted(found, reverse=True):
            text = f"{text[:begin]}{new}{text[end:]}"
        changed |= {path: text.encode()} if found else {}
    return changed


def _edits_of(name: str, value: str, now: datetime) -> tuple[Sequence[str], Mapping[re.Pattern[str], str]]:
    """Return the files of a setting, and the new text for the first group of each pattern.

    Raises:
        KeymintError: the value is not one of the setting; a usage error.
    """
    if name == "domain":
        return (_PERMISSIONS, "package.defaults/governance.xml"), {_DOMAIN: bootstrap.checked_domain(value)}
    if name == "valid-for":
        begin = validity.begin_of_period(value, now)
        return (_PERMISSIONS, _IDENTITIES), {_BEGIN: begin, _END: f"<duration>{value}</duration>"}
    if name == "subject-format":
        distros.check_choice("subject format", value, bootstrap.SUBJECT_NAMES, "subject-format-unknown")
        return (_PERMISSIONS, _IDENTITIES), {_SUBJECT_NAME: bootstrap.SUBJECT_NAMES[value]}
    return (MANIFEST,), {_DISTRO: distros.check(value)}
