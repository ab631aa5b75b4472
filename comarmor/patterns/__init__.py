# SPDX-License-Identifier: Apache-2.0
"""Patterns of names: how they are read and printed, what they match, and proofs about lists of them.

Start at :mod:`~comarmor.patterns.glob` for one pattern, and at :mod:`~comarmor.patterns.proofs` for lists of them.
"""
