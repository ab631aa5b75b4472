# SPDX-License-Identifier: Apache-2.0
"""Verbs that take over, translate or learn policies and keystores, one file each."""
