# SPDX-License-Identifier: Apache-2.0
"""A manifest has one form, which the published schema describes."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

import jsonschema
import pytest

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.names import ROOT
from keymint.robots.bundle import Manifest, dump, load
from tests.conftest import CHECKOUT

WHERE = Origin("talker.bundle")
SCHEMA = json.loads((CHECKOUT / "schemas/keymint/bundle.schema.json").read_text())
MANIFEST = Manifest(
    enclave="/robot/talker",
    folder="enclaves",
    key="0" * 64,
    authority="1" * 64,
    generation=2,
    issue=1_800_000_000,
    revocations=3,
    nonce="ab" * 16,
    not_before=datetime(2027, 1, 14, tzinfo=UTC),
    not_after=datetime(2028, 1, 14, tzinfo=UTC),
    files={"cert.pem": "2" * 64, "key.pem": "3" * 64},
)
VALUES = json.loads(dump(MANIFEST))


def encoded(values: Any) -> bytes:
    return json.dumps(values, sort_keys=True, separators=(",", ":")).encode()


def code(content: bytes) -> str:
    with pytest.raises(KeymintError) as refused:
        load(content, WHERE)
    [diagnostic] = refused.value.diagnostics
    assert diagnostic.where == WHERE
    return diagnostic.code


def test_what_is_written_is_read() -> None:
    assert load(dump(MANIFEST), WHERE) == MANIFEST
    assert MANIFEST.name == "robot/talker"
    jsonschema.validate(VALUES, SCHEMA)


def test_the_root_enclave_has_no_place_at_the_top_of_a_keystore() -> None:
    root = {**VALUES, "enclave": "/"}
    assert load(encoded(root), WHERE).name == "root-enclave"
    jsonschema.validate(root, SCHEMA)
    for other in ({**root, "folder": ""}, {**root, "enclave": ROOT}, {**root, "enclave": f"/{ROOT}"}):
        assert code(encoded(other)) == "bundle-manifest"


def test_other_forms_of_the_same_json_are_refused() -> None:
    assert encoded(VALUES) == dump(MANIFEST)
    content = dump(MANIFEST)
    for other in (
        content + b"\n",
        json.dumps(VALUES, sort_keys=True).encode(),
        json.dumps(VALUES, separators=(",", ":"), sort_keys=False).encode()[::-1],
        content.replace(b'"version":1', b'"version":1.0'),
        content.replace(b'"version":1', b'"version":true'),
        content.replace(b'"version":1}', b'"version":1,"version":1}'),
        content.replace(b"/robot", b"\\u002frobot"),
        content.replace(b"00:00:00Z", b"00:00:00+00:00", 1),
        b"\xef\xbb\xbf" + content,
    ):
        assert code(other) == "bundle-manifest"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("enclave", "robot/talker"), ("enclave", "/../x"), ("enclave", 7), ("enclave", "/a/"),
        ("folder", ".."), ("folder", "a/b"), ("folder", "/etc"), ("folder", ".keymint"), ("folder", None),
        ("key", "0" * 63), ("key", "G" * 64), ("authority", ""), ("authority", []),
        ("generation", -1), ("generation", 1.5), ("generation", True), ("generation", 1 << 53),
        ("issue", 0), ("issue", "1"), ("revocations", -1), ("nonce", "ab"), ("nonce", None),
        ("not_before", "2027-01-14"), ("not_before", "2027-13-14T00:00:00Z"), ("not_after", 5),
        ("files", {}), ("files", {"../a": "0" * 64}), ("files", {"a/b": "0" * 64}), ("files", {".a": "0" * 64}),
        ("files", {"a": "0"}), ("files", []), ("format", "other"), ("version", 0), ("version", "1"), ("more", 1),
    ],
)  # fmt: skip
def test_what_is_refused(key: str, value: object) -> None:
    values = {**VALUES, key: value}
    assert code(encoded(values)) == "bundle-manifest"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(values, SCHEMA)


@pytest.mark.parametrize("key", VALUES)
def test_every_value_is_required(key: str) -> None:
    values = {name: value for name, value in VALUES.items() if name != key}
    assert code(encoded(values)) == "bundle-manifest"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(values, SCHEMA)


@pytest.mark.parametrize("content", [b"", b"[]", b"null", b"7", b'"x"', b"[" * 60_000, b"\xff", b" " * (1 << 17)])
def test_garbage_is_refused(content: bytes) -> None:
    assert code(content) == "bundle-manifest"


def test_a_later_version_says_so() -> None:
    assert code(encoded({**VALUES, "version": 2, "more": 1})) == "bundle-version"
