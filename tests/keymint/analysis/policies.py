# SPDX-License-Identifier: Apache-2.0
"""Test policies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import keymint_ros2_comarmor

from comarmor.errors import Origin
from keymint.api import LoadedPolicy, PolicySource

Written = Callable[[str], LoadedPolicy]


def rule(kind: str, permissions: str, *names: str, effect: str = "ALLOW") -> str:
    """Return a rule, on one line."""
    attached = "".join(f"<attachment>{name}</attachment>" for name in names)
    held = "".join(f"<{permission}/>" for permission in permissions.split())
    return f'<{kind} qualifier="{effect}">{attached}<permissions>{held}</permissions></{kind}>\n'


def deny(kind: str, permissions: str, *names: str) -> str:
    """Return a DENY rule."""
    return rule(kind, permissions, *names, effect="DENY")


def profile(attachment: str, *inside: str) -> str:
    """Return a profile; its first line is its own."""
    return f'<profile name="{attachment}"><attachment>{attachment}</attachment>\n{"".join(inside)}</profile>\n'


def loaded(folder: Path, *profiles: str, name: str = "policy.xml") -> LoadedPolicy:
    """Return the policy of these profiles; the first one stands in line 2."""
    return loaded_text(folder, "<profiles>\n" + "".join(profiles) + "</profiles>", name=name)


def loaded_text(folder: Path, text: str, *, name: str = "policy.xml") -> LoadedPolicy:
    """Return the policy of a text."""
    path = folder / name
    path.write_text(text)
    return keymint_ros2_comarmor.policy_type.load([PolicySource(name, path, Origin(name))], None)
