# SPDX-License-Identifier: Apache-2.0
"""Compiler passes over patterns and names that know no transport."""
