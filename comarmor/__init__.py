# SPDX-License-Identifier: Apache-2.0
"""ComArmor: mandatory access control for communication graphs, as AppArmor is for Linux processes.

Profiles attach to subjects (a ROS 2 node or enclave), and their rules allow or deny permissions on objects (topics,
services, actions, parameters).

    >>> import comarmor
    >>> policy = comarmor.load("comarmor.d")  # doctest: +SKIP
    >>> policy.decide("/talker", "ros_topic", "ros_publish", "/chatter").allowed  # doctest: +SKIP
    True

The names below load on first use, so that importing ``comarmor.text`` or ``comarmor.patterns`` loads no XML library.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from comarmor.errors import (
        ComArmorError as ComArmorError,
        Diagnostic as Diagnostic,
        Origin as Origin,
        Severity as Severity,
    )
    from comarmor.language.formatting import render as render
    from comarmor.language.loading import load as load
    from comarmor.language.policy import Policy as Policy
    from comarmor.language.syntax import (
        Attachment as Attachment,
        Decision as Decision,
        Profile as Profile,
        ProfileRule as ProfileRule,
    )
    from comarmor.rules import PARTS as PARTS, PERMISSIONS as PERMISSIONS, Effect as Effect, Rule as Rule


_MODULES = {
    "comarmor.errors": ("ComArmorError", "Diagnostic", "Origin", "Severity"),
    "comarmor.language.loading": ("load",),
    "comarmor.language.policy": ("Policy",),
    "comarmor.language.formatting": ("render",),
    "comarmor.language.syntax": ("Decision", "Attachment", "Profile", "ProfileRule"),
    "comarmor.rules": ("PARTS", "PERMISSIONS", "Effect", "Rule"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name from the module that defines it (PEP 562)."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)
