# SPDX-License-Identifier: Apache-2.0
"""Standard streams report failed writes, and signals end the process in order."""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from keymint.host.streams_and_signals import Output, OutputError


def ran(script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=False, timeout=60
    )


def test_text_and_bytes_keep_their_order(tmp_path: Path) -> None:
    path = tmp_path / "out"
    with path.open("w", encoding="ascii") as stream:
        output = Output(stream)
        assert not output.began
        output.write("")
        assert not output.began
        assert output.write("a\u00e9") == 2
        output.buffer.write(b"\xff\x00")
        output.write("b")
        output.flush()
        assert output.began
    assert path.read_bytes() == b"a\\xe9\xff\x00b"


def test_bytes_are_shown_where_a_stream_takes_only_text() -> None:
    stream = io.StringIO()
    Output(stream).put(b"a\xff")
    assert stream.getvalue() == "a\\xff"


@pytest.mark.parametrize("required", [True, False])
def test_a_write_that_fails_is_an_error_only_where_output_is_required(required: bool) -> None:
    with open("/dev/full", "w", encoding="utf-8") as stream:  # noqa: PTH123
        output = Output(stream, required=required)
        output.write("lost")
        if required:
            with pytest.raises(OutputError, match="No space left"):
                output.flush()
            output.give_up()
        else:
            output.flush()


@pytest.mark.parametrize("connected", [os.pipe, lambda: [each.detach() for each in socket.socketpair()]])
def test_what_nobody_reads_is_lost_without_an_error(connected: Callable[[], Sequence[int]]) -> None:
    reading, writing = connected()
    os.close(reading)
    with open(writing, "w", encoding="utf-8") as stream:  # noqa: PTH123
        output = Output(stream)
        output.write("x")
        output.put(b"x" * 100_000)
        output.write("x")
        output.flush()


def test_a_stream_that_does_not_exist() -> None:
    with pytest.raises(OutputError, match="closed"):
        Output(None).write("x")
    assert Output(None, required=False).write("x") == 1
    assert not Output(None).isatty()
    Output(None).flush()


def test_no_other_file_takes_the_place_of_a_missing_stream() -> None:
    done = ran("""
        import os, sys
        from keymint.host.streams_and_signals import open_missing_streams
        os.close(0), os.close(2)
        open_missing_streams()
        sys.stdout.write(str(os.open(os.devnull, os.O_RDONLY) > 2))
    """)
    assert done.stdout == "True"


SIGNALLED = """
    import os, signal, sys
    from keymint.host import streams_and_signals as process
    process.stop_on_signals()
    try:
        os.kill(os.getpid(), signal.{name})
    except process.StoppedError as error:
        print(error, error.number, process.received_signal())
    {after}
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_is_raised_once_and_the_second_one_ends_the_process(name: str) -> None:
    number = getattr(signal, name)
    done = ran(SIGNALLED.format(name=name, after=""))
    assert (done.stdout, done.returncode) == (f"{name} {number} {number}\n", 0)
    done = ran(SIGNALLED.format(name=name, after=f"sys.stdout.flush(); os.kill(os.getpid(), {number}); print('on')"))
    assert (done.stdout, done.returncode) == (f"{name} {number} {number}\n", -number)


def test_a_signal_waits_while_signals_are_held() -> None:
    done = ran("""
        import os, signal
        from keymint.host import streams_and_signals as process
        process.stop_on_signals()
        try:
            with process.held_signals():
                os.kill(os.getpid(), signal.SIGTERM)
                print("held", process.received_signal())
        except process.StoppedError:
            print("stopped")
    """)
    assert done.stdout == "held 0\nstopped\n"


def test_an_ignored_signal_stays_ignored_and_none_interrupts_the_end() -> None:
    done = ran("""
        import os, signal
        from keymint.host import streams_and_signals as process
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        process.stop_on_signals()
        os.kill(os.getpid(), signal.SIGINT)
        process.settle()
        os.kill(os.getpid(), signal.SIGTERM)
        print("done")
    """)
    assert (done.stdout, done.returncode) == ("done\n", 0)
