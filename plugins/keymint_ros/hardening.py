# SPDX-License-Identifier: Apache-2.0
"""Edit profiles and packages that were taken over: a unique subject name, and an authority of its own for signatures.

Only the elements that change are edited, as text, so that comments and all else stay. What a person wrote in another
way than Keymint does is an error that says what to write.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from comarmor.errors import Origin
from comarmor.regex import lazy_regex
from keymint.api import Validity, WorkspaceProfile
from keymint.errors import KeymintError
from keymint_ros import bootstrap, manifest
from keymint_ros.manifest import SIGNER
from keymint_ros.profile_reader import base_of

_NAME = lazy_regex(r"<subject_name>[^<]*</subject_name>")
_VALIDITY = lazy_regex(r"^([ \t]*)<validity>", re.MULTILINE)
_AUTHORITIES = "authorities.xml"
_SIGNED = ("package.defaults/permissions.xml", "package.defaults/governance.xml")
_COMMENT = lazy_regex(r"<!--.*?-->", re.DOTALL)
_Edit = Callable[[str], "tuple[int, int, str] | None"]
"""Returns where a text without comments is replaced, from and to, and by what; None if it has no such place."""


def with_unique_name(profile: WorkspaceProfile, name: str, files: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.HardenedPackageType.with_unique_name`."""
    del profile
    element = f"<subject_name>{bootstrap.SUBJECT_NAMES['unique']}</subject_name>"

    def edit(text: str) -> tuple[int, int, str] | None:
        if present := _NAME.search(text):
            return *present.span(), element
        before = _VALIDITY.search(text)
        return before and (before.start(), before.start(), f"{before[1]}{element}\n")

    changed: dict[str, bytes] = {}
    for part in ("identities", "permissions"):
        path = manifest.path_of(part, name, files)
        changed |= _edited(files, path, f"{name}/{path}", edit, f"write {element} into it")
    return changed


def with_own_signer(profile: WorkspaceProfile, former: str, validity: Validity | None = None) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.HardenedProfileType.with_own_signer`."""
    base = base_of(profile)
    element = re.compile(rf"<issuer_name>\s*{re.escape(former)}\s*</issuer_name>")
    wanted = f"<issuer_name>{SIGNER}</issuer_name>"

    def add(text: str) -> tuple[int, int, str] | None:
        at = text.rfind("  </authorities>")
        lines = bootstrap.authority(SIGNER, validity)
        return None if at < 0 else (at, at, "".join(f"    {line}\n" for line in lines))

    def edit(text: str) -> tuple[int, int, str] | None:
        present = element.search(text)
        return present and (*present.span(), wanted)

    help_ = f'add <authority name="{SIGNER}"> to it'
    changed = _edited(profile.files, _AUTHORITIES, base + _AUTHORITIES, add, help_)
    for path in _SIGNED:
        changed |= _edited(profile.files, path, base + path, edit, f"write {wanted}")
    return changed


def _edited(files: Mapping[str, bytes], path: str, shown: str, edit: _Edit, help_: str) -> dict[str, bytes]:
    """Return a file after an edit.

    Raises:
        KeymintError: there is no such file, or it is written in another way than Keymint writes it.
    """
    text = _text(files.get(path, b""))
    # Nothing is found in a comment, and all other places stay.
    place = edit(_COMMENT.sub(lambda comment: re.sub(r"[^\n]", " ", comment[0]), text))
    if place is None:
        raise KeymintError(
            "is written in a way that Keymint does not edit", where=Origin(shown), help=help_, code="harden-by-hand"
        )
    begin, end, new = place
    return {path: f"{text[:begin]}{new}{text[end:]}".encode()}


def _text(content: bytes) -> str:
    """Return the text of a file; empty if it is not UTF-8, as nothing that Keymint writes."""
    try:
        return content.decode()
    except UnicodeDecodeError:
        return ""
