# SPDX-License-Identifier: Apache-2.0
"""What lies on the disk, and what was made from what; nothing here writes.

Start at :class:`keymint.view.tree.Tree`, the files of a run, planned changes included.
"""
