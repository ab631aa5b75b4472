# SPDX-License-Identifier: Apache-2.0
"""Prove that permissions documents permit exactly what the policy allows, over all names.

The installed, signed document is read again and translated into decision lists: as the standard reads it, and as the
model of each vendor does. :mod:`comarmor.patterns.proofs` compares them with the decision lists of the policy. Each
counterexample is checked again by evaluating the policy's rules, and by the decision point.

Open ``claims`` first.
"""
