# SPDX-License-Identifier: Apache-2.0
"""Verbs that explain a policy, one file each."""
