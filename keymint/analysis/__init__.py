# SPDX-License-Identifier: Apache-2.0
"""Policy analysis: redundant rules, semantic diff, queries and policy tests.

Pure functions over rules and the proof engine. Answers hold for all possible names, not for samples.

Start at :mod:`~keymint.analysis.rule_lists` for the question on one subject, and at
:mod:`~keymint.analysis.symbolic_search` for that on all subjects at once. ``policy_diff``, ``query``, ``channels``,
``policy_tests`` and ``lint_rules``, which finds likely mistakes, ask them.
"""
