# SPDX-License-Identifier: Apache-2.0
"""Keystores that other tools made: where their files are, and what is right and wrong about them."""
