# SPDX-License-Identifier: Apache-2.0
"""The verbs, one file each, in the groups that ``keymint --help`` shows.

Start at any verb: it makes the ``result`` of its ``--json``, and its words from that. What verbs share is
:mod:`keymint.command_line`.
"""
