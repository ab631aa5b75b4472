# SPDX-License-Identifier: Apache-2.0
"""What a workspace says and holds: its folders, profile, packages, policy and installed enclaves.

Start at :class:`keymint.workspace.session.Session`, which every stage reads.
"""
