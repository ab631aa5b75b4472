# SPDX-License-Identifier: Apache-2.0
"""What plugins name and do not load: functions and transports, which are imported when they are first used."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from typing import Any

from keymint.api import API_VERSION, Environment, Transport


def lazy(target: str) -> Any:
    """Return a static method that calls a function, so that listing plugins loads neither XML nor cryptography.

    Args:
        target: ``module:function``.
    """
    module, _, name = target.partition(":")
    imported = cache(partial(import_module, module))

    def call(*arguments: Any, **options: Any) -> Any:
        return getattr(imported(), name)(*arguments, **options)

    return staticmethod(call)


class LazyTransport:
    """Implements :class:`keymint.api.TransportType`.

    Args:
        build_type: name of the build type whose files the transport reads.
        make: returns the transport; imports its module, as :func:`lazy` does.
    """

    API = API_VERSION

    def __init__(self, build_type: str, make: Callable[[Environment], Transport]) -> None:
        self.BUILD_TYPE = build_type
        self.open = make
