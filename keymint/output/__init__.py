# SPDX-License-Identifier: Apache-2.0
"""Formats that other tools read findings and test results from: SARIF and JUnit."""
