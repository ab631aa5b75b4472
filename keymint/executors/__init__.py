# SPDX-License-Identifier: Apache-2.0
"""Carry out parts of a verb in other processes, here or on a cluster.

What runs there is a function of a module, ``(plugins, task) -> result``, where task and result are plain data without
secrets. Keys, signatures and files stay in the process that the user started.
"""

from keymint.executors.pool import Pool

__all__ = ["PROCESSES", "Pool"]

PROCESSES = "processes"
"""The executor that is not a cluster: processes of this machine."""
