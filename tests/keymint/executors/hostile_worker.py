# SPDX-License-Identifier: Apache-2.0
"""Loaded by the workers of the tests (``dask worker --preload``): what a worker may do instead of its work.

The file that ``HOSTILE_WORKER`` names says what; while it is empty, the worker is honest.
"""

import os
import pickle
import time
from pathlib import Path

import distributed.worker
from distributed import get_worker
from distributed.protocol import to_serialize

from keymint.executors import cluster as worker

ORDER = Path(os.environ["HOSTILE_WORKER"])
honest = getattr(worker, "honest", worker.carry_out)  # this file is loaded more than once


class Evil:
    """Makes a folder with the number of the process that unpickles it."""

    def __reduce__(self):
        return eval, (f"__import__('os').mkdir({str(ORDER.parent / 'read-by-')!r} + str(__import__('os').getpid()))",)


def carry_out(content: bytes) -> object:
    """Do what the file says."""
    order = ORDER.read_text()
    if order == "object":
        return Evil()
    if order == "exception":
        raise ValueError
    if order == "event":
        get_worker().log_event("warn", {"message": pickle.dumps(Evil())})
    if order == "widen":
        return honest(content).replace(b"rt/chatter", b"rt/other")
    if order == "die once":
        ORDER.write_text("")
        os._exit(1)
    if order == "wait":
        ORDER.with_name("waiting").touch()
        time.sleep(60)
    return honest(content)


def error_message(error: BaseException) -> dict[str, object]:
    """Put something else in the place of an exception."""
    return {**worker.message_of(error), "exception": to_serialize(pickle.dumps(Evil()))}


worker.message_of = getattr(worker, "message_of", distributed.worker.error_message)
distributed.worker.error_message = error_message
worker.honest, worker.carry_out = honest, carry_out
carry_out.__module__, carry_out.__qualname__ = honest.__module__, honest.__qualname__
