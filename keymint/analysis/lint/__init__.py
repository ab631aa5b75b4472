# SPDX-License-Identifier: Apache-2.0
"""Likely mistakes in a policy. Start at :mod:`~keymint.analysis.lint.lint_rules`."""
