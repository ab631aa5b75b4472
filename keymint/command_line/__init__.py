# SPDX-License-Identifier: Apache-2.0
"""What verbs share: their options, the files and policies that they name, how they report.

Start at :func:`keymint.command_line.verb.verb`.
"""
