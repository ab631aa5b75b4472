# SPDX-License-Identifier: Apache-2.0
"""The manifest of a bundle: for which enclave and key it is, its numbers, and the digest of every file.

It is JSON in a canonical form (that of RFC 8785 for the values that occur), which is the only one that is read;
``schemas/keymint/bundle.schema.json`` describes it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any

from comarmor.errors import Origin
from comarmor.regex import lazy_regex
from comarmor.values import dataclass
from keymint.errors import KeymintError
from keymint.names import name_of, package_name, subject_of
from keymint.robots import bundle_container

FORMAT = "keymint-bundle"
VERSION = 1
MAX_BYTES = 1 << 16
MAX_NUMBER = 1 << 53
"""Numbers of JSON are exact below this (RFC 8259, 6)."""
_DIGEST = lazy_regex(r"[0-9a-f]{64}")
_NONCE = lazy_regex(r"(?:[0-9a-f]{32})?")
_FOLDER = lazy_regex(r"(?:[A-Za-z0-9][A-Za-z0-9_-]{0,99})?")


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a bundle is for.

    Attributes:
        enclave: the enclave, e.g. ``/robot/talker``.
        folder: the folder of all enclaves below the keystore; empty if they lie at its top.
        key: fingerprint of the certified public key (see :func:`keymint.pki.keys.fingerprint`).
        authority: fingerprint of the key of the authority that issued the certificate and signs the manifest.
        generation: generation of the subject name; see :class:`keymint.api.Issuance`.
        issue: rises with every bundle for the enclave, at least 1.
        revocations: number of the authority's revocation list in the bundle; 0 if it has none.
        nonce: the nonce of the request that the bundle answers; empty if it answers none.
        not_before: from when on all that is in the bundle is in force, UTC.
        not_after: how long all that is in the bundle is in force, UTC.
        files: SHA-256 of every file of the enclave, in hexadecimal digits, by name.
    """

    enclave: str
    folder: str
    key: str
    authority: str
    generation: int
    issue: int
    revocations: int
    nonce: str
    not_before: datetime
    not_after: datetime
    files: Mapping[str, str]

    @property
    def name(self) -> str:
        """The name of the enclave's package."""
        return name_of(self.enclave)


def dump(manifest: Manifest) -> bytes:
    """Return a manifest in its canonical form."""
    values = {each.name: getattr(manifest, each.name) for each in fields(manifest)}
    values |= {"format": FORMAT, "version": VERSION}
    return json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=_encoded).encode()


def _encoded(value: Mapping[str, str] | datetime) -> object:
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    return dict(value)


def load(content: bytes, where: Origin) -> Manifest:
    """Return a manifest.

    Args:
        content: what :func:`dump` wrote.
        where: its file, for messages.

    Raises:
        KeymintError: ``bundle-manifest``: it is not in the canonical form. ``bundle-version``: a later version of
            Keymint wrote it.
    """
    try:
        values: Any = json.loads(content.decode("ascii")) if len(content) <= MAX_BYTES else None
        version = values["version"] if values["format"] == FORMAT else None
        manifest = None if version != VERSION else _manifest(values)
    except (KeymintError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        manifest = version = None
    if isinstance(version, int) and version > VERSION:
        raise KeymintError(
            f"is a bundle of version {version}, expected {VERSION}",
            where=where,
            help="install the version of Keymint that the authority has",
            code="bundle-version",
        )
    if manifest is None or dump(manifest) != content:
        raise KeymintError(
            "its manifest is damaged, or not what 'keymint bundle' writes",
            where=where,
            help="copy the bundle again from the authority",
            code="bundle-manifest",
        )
    return manifest


def _manifest(values: Mapping[str, Any]) -> Manifest:
    """Return the manifest with these values.

    Raises:
        ValueError: a value is not legal. Other errors: there is no such value, or it has another type.
    """
    enclave = subject_of(package_name(values["enclave"]))
    files = {
        _matching(bundle_container.NAME, name): _matching(_DIGEST, value) for name, value in values["files"].items()
    }
    if not files or (enclave == "/" and not values["folder"]):  # the root enclave has no place there
        raise ValueError
    return Manifest(
        enclave=enclave,
        folder=_matching(_FOLDER, values["folder"]),
        key=_matching(_DIGEST, values["key"]),
        authority=_matching(_DIGEST, values["authority"]),
        generation=_number(values["generation"], 0),
        issue=_number(values["issue"], 1),
        revocations=_number(values["revocations"], 0),
        nonce=_matching(_NONCE, values["nonce"]),
        not_before=_moment(values["not_before"]),
        not_after=_moment(values["not_after"]),
        files=files,
    )


def _matching(form: re.Pattern[str], text: str) -> str:
    if not form.fullmatch(text):
        raise ValueError
    return text


def _number(value: object, least: int) -> int:
    if type(value) is not int or not least <= value < MAX_NUMBER:
        raise ValueError
    return value


def _moment(text: str) -> datetime:
    return datetime.fromisoformat(text).astimezone(UTC)
