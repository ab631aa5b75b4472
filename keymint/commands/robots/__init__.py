# SPDX-License-Identifier: Apache-2.0
"""Verbs for robots that make their own keys, and for the authority that answers them, one file each."""
