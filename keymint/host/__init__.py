# SPDX-License-Identifier: Apache-2.0
"""The machine that Keymint runs on, not its files: processes, signals, git.

Start at :mod:`~keymint.host.vendor_process`, which runs the programs of vendors. Work is divided by
:mod:`~keymint.host.pool`.
"""
