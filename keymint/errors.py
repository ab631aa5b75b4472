# SPDX-License-Identifier: Apache-2.0
"""The error type and the exit codes, under the names that Keymint and its plugins use."""

from comarmor.errors import ComArmorError as KeymintError
from comarmor.errors import ExitCode

__all__ = ["ExitCode", "KeymintError"]
