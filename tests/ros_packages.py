# SPDX-License-Identifier: Apache-2.0
"""Fake prefixes of ROS 2 with packages that ship profiles, and policies that include these."""

from __future__ import annotations

from pathlib import Path

XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'
PACKAGE = "nav2_bringup"
HREF = f"package://{PACKAGE}/controller.xml"


def topic(name: str, permission: str = "ros_publish", qualifier: str = "ALLOW") -> str:
    """Return a rule about a topic."""
    attachment, permissions = f"<attachment>{name}</attachment>", f"<permissions><{permission}/></permissions>"
    return f'<ros_topic qualifier="{qualifier}">{attachment}{permissions}</ros_topic>'


def fragment(*rules: str, subjects: str = "*") -> str:
    """Return a file as a package ships it: a profile that applies to any subject of the profile that includes it."""
    return f'<profile name="shipped" {XI}>\n<attachment>{subjects}</attachment>\n{"".join(rules)}</profile>'


def including(*hrefs: str, subject: str = "/robot/controller") -> str:
    """Return a policy with one profile that includes files."""
    includes = "".join(f'\n<xi:include href="{href}"/>' for href in hrefs)
    profile = f'<profile name="own"><attachment>{subject}</attachment>{includes}</profile>'
    return f'<profiles {XI}>{profile}<profile name="other"><attachment>/other</attachment></profile></profiles>'


def ship(prefix: Path, files: dict[str, str], package: str = PACKAGE, *, registered: bool = True) -> Path:
    """Install files of a package in a prefix, and return their folder."""
    folder = prefix / "share" / package / "keymint/comarmor.d"
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    if registered:
        register(prefix, package)
    return folder


def register(prefix: Path, package: str = PACKAGE) -> None:
    """Enter a package into the index of a prefix, as ament does."""
    marker = prefix / "share/ament_index/resource_index/packages" / package
    marker.parent.mkdir(parents=True, exist_ok=True)
    marker.touch()
