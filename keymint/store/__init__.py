# SPDX-License-Identifier: Apache-2.0
"""The only writer: an enclave is old or new, whenever a run is killed.

Start at :class:`keymint.store.store.Store`, which writes workspaces and keystores; a file is replaced in
:mod:`~keymint.store.group_commit`. Files that a user names, such as those of ``-o``, are written by
:mod:`~keymint.store.user_files`.
"""
