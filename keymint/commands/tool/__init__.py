# SPDX-License-Identifier: Apache-2.0
"""Verbs about Keymint itself, one file each."""
