# SPDX-License-Identifier: Apache-2.0
"""The former place of :mod:`keymint.api.source_documents`, for plugins of API 2.0; API 3.0 will not have it."""

from keymint.api.source_documents import (
    DEFAULT_DOMAINS,
    Reader,
    domains,
    file_in,
    incomplete,
    normal_path,
    parse,
    place,
    require_new,
    signer,
    text,
)

__all__ = [
    "DEFAULT_DOMAINS",
    "Reader",
    "domains",
    "file_in",
    "incomplete",
    "normal_path",
    "parse",
    "place",
    "require_new",
    "signer",
    "text",
]
