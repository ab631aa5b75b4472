# SPDX-License-Identifier: Apache-2.0
"""What people and other tools see: the console, JSON, SARIF, JUnit, Markdown, OpenMetrics. Start at ``console.py``."""
