# SPDX-License-Identifier: Apache-2.0
"""The verbs, one file each, in the groups that ``keymint --help`` shows."""
