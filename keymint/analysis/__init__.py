# SPDX-License-Identifier: Apache-2.0
"""Policy analysis: redundant rules, semantic diff, queries and policy tests.

Pure functions over rules and the proof engine. Answers hold for all possible names, not for samples.
"""
