# SPDX-License-Identifier: Apache-2.0
"""Verbs that make a keystore from a policy, one file each."""
