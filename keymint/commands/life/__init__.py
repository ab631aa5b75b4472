# SPDX-License-Identifier: Apache-2.0
"""Verbs that renew, revoke and replace, one file each; three of ``authority`` are in ``authority_change.py``."""
