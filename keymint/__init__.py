# SPDX-License-Identifier: Apache-2.0
"""Keymint: a meta-build tool that mints keys and notarizes access-control documents for robots."""

__version__ = "1.0.0"
"""What 1.x keeps is in docs/compatibility.md."""
SPACES = ("profile", "private", "public", "src", "build", "install")
"""The folders of a workspace; see :class:`keymint.workspace.workspace.Workspace`."""
