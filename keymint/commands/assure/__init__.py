# SPDX-License-Identifier: Apache-2.0
"""Verbs that examine and prove a keystore, one file each."""
