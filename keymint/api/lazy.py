# SPDX-License-Identifier: Apache-2.0
"""Functions that plugins name and do not load: their module is imported when they are first called."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

_module = cache(import_module)


def lazy(target: str) -> Any:
    """Return a static method that calls a function, so that listing plugins loads neither XML nor cryptography.

    Args:
        target: ``module:function``.
    """
    module, _, name = target.partition(":")

    def call(*arguments: Any, **options: Any) -> Any:
        return getattr(_module(module), name)(*arguments, **options)

    return staticmethod(call)
