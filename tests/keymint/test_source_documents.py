# SPDX-License-Identifier: Apache-2.0
"""Plugins that import the reader of documents by its former name get the same one."""

from __future__ import annotations

from keymint import source_documents
from keymint.api import source_documents as present


def test_the_former_name_has_all_that_is_public() -> None:
    public = {name for name, value in vars(present).items() if getattr(value, "__module__", "") == present.__name__}
    assert {name for name in public if not name.startswith("_")} <= set(source_documents.__all__)
    assert all(getattr(source_documents, name) is getattr(present, name) for name in source_documents.__all__)
