# SPDX-License-Identifier: Apache-2.0
"""What was taken over: the sources of a package whose certificate and documents another tool made, and later edits.

The edits are a unique subject name, and an authority of its own for signatures. Only the elements that change are
edited, as text, so that comments and all else stay. What a person wrote in another way than Keymint does is an error
that says what to write.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from comarmor.errors import Origin
from comarmor.regex import lazy_regex
from keymint.api import AdoptedSources, DomainRange, KeySpec, Validity, WorkspaceProfile
from keymint.errors import KeymintError
from keymint_ros import bootstrap, manifest, permissions, validity
from keymint_ros.bootstrap import filled_file
from keymint_ros.manifest import SIGNER
from keymint_ros.profile_reader import base_of

PREFIX = "adopted."
"""Prefix of the files of a package that are documents which another tool signed: ``adopted.permissions.xml``."""
_SPECIAL = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def adopted_sources(profile: WorkspaceProfile, sources: AdoptedSources) -> Mapping[str, bytes]:
    """Return the files of a package: see :meth:`keymint.api.PackageType.adopted_sources`."""
    domains = [_domains(sources.domains)] if sources.domains else []
    name = [f"<subject_name>{sources.subject_name.translate(_SPECIAL)}</subject_name>"] if sources.subject_name else []
    cert = (*name, validity.element(sources.validity))
    overrides = (*domains, *name, validity.element(sources.grant_validity))
    return {
        **bootstrap.package(profile.build_types),
        "identities.xml": filled_file("package/identities.adopted.xml", cert=cert, key=_key(sources.key)),
        "permissions.xml": permissions.render(sources.rules, base_of(profile), overrides=overrides),
        **{f"{PREFIX}{name}": content for name, content in sources.documents.items()},
    }


def _domains(ranges: Sequence[DomainRange]) -> str:
    ids = [
        f"<id>{each.first}</id>"
        if each.first == each.last
        else f"<id_range><min>{each.first}</min><max>{each.last}</max></id_range>"
        for each in ranges
    ]
    return f"<domains>{''.join(ids)}</domains>"


def _key(key: KeySpec) -> tuple[str, ...]:
    kind = (
        f"<ec><curve>{key.curve}</curve></ec>"
        if key.algorithm == "ec"
        else f"<rsa><key_size>{key.size}</key_size></rsa>"
    )
    return (
        f"<asymmetric_type>{kind}</asymmetric_type>",
        "<encryption_algorithm>NoEncryption</encryption_algorithm>",
        "<password_env></password_env>",
    )


_NAME = lazy_regex(r"<subject_name>[^<]*</subject_name>")
_VALIDITY = lazy_regex(r"^(?=([ \t]*)<validity>)", re.MULTILINE)
_END = lazy_regex(r"(?=  </authorities>)(?!.+  </authorities>)", re.DOTALL)
_AUTHORITIES = "authorities.xml"
_SIGNED = ("package.defaults/permissions.xml", "package.defaults/governance.xml")
_COMMENT = lazy_regex(r"<!--.*?-->", re.DOTALL)


def with_unique_name(profile: WorkspaceProfile, name: str, files: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.PackageType.with_unique_name`."""
    del profile
    element = f"<subject_name>{bootstrap.SUBJECT_NAMES['unique']}</subject_name>"
    edits = {_NAME: element, _VALIDITY: rf"\1{element}\n"}
    changed: dict[str, bytes] = {}
    for part in ("identities", "permissions"):
        path = manifest.path_of(part, name, files)
        changed |= _edited(files, path, f"{name}/{path}", edits, f"write {element} into it")
    return changed


def with_own_signer(profile: WorkspaceProfile, former: str, period: Validity | None = None) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.ProfileType.with_own_signer`."""
    base = base_of(profile)
    wanted = f"<issuer_name>{SIGNER}</issuer_name>"
    added = "".join(f"    {line}\n" for line in bootstrap.authority(SIGNER, period))
    help_ = f'add <authority name="{SIGNER}"> to it'
    changed = _edited(profile.files, _AUTHORITIES, base + _AUTHORITIES, {_END: added}, help_)
    edits = {re.compile(rf"<issuer_name>\s*{re.escape(former)}\s*</issuer_name>"): wanted}
    for path in _SIGNED:
        changed |= _edited(profile.files, path, base + path, edits, f"write {wanted}")
    return changed


def _edited(
    files: Mapping[str, bytes], path: str, shown: str, edits: Mapping[re.Pattern[str], str], help_: str
) -> dict[str, bytes]:
    """Return a file after an edit: the first place of the first pattern that it has gets a new text.

    Raises:
        KeymintError: there is no such file, or it is written in another way than Keymint writes it.
    """
    try:
        text = files.get(path, b"").decode()
    except UnicodeDecodeError:
        text = ""  # nothing that Keymint writes is like this
    # Nothing is found in a comment, and all other places stay.
    plain = _COMMENT.sub(lambda comment: re.sub(r"[^\n]", " ", comment[0]), text)
    for pattern, new in edits.items():
        if found := pattern.search(plain):
            return {path: f"{text[: found.start()]}{found.expand(new)}{text[found.end() :]}".encode()}
    raise KeymintError(
        "is written in a way that Keymint does not edit", where=Origin(shown), help=help_, code="harden-by-hand"
    )
