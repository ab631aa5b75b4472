# SPDX-License-Identifier: Apache-2.0
"""Where PINs come from."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from keymint.errors import KeymintError
from keymint.pki.tokens.token_sessions import PIN_MISSING, PIN_REFUSED, PIN_VARIABLE, Tokens

SECRET = "4711-pin"


def never(_text: str) -> str:
    raise AssertionError("asked the user")


def test_a_file_that_is_named_comes_first(tmp_path: Path) -> None:
    file = tmp_path / "pin"
    file.write_text(f"{SECRET}\n")
    file.chmod(0o600)
    assert Tokens({PIN_VARIABLE: "other", "CA_PIN": "other"}, never).pin("ca", str(file), "CA_PIN") == SECRET


def test_the_variable_that_is_named_comes_before_the_usual_one() -> None:
    pins = Tokens({PIN_VARIABLE: "usual", "CA_PIN": "named"}, never)
    assert (pins.pin("ca", "", "CA_PIN"), pins.pin("ca", "", "")) == ("named", "usual")


def test_the_user_is_asked_last() -> None:
    asked: list[str] = []
    pins = Tokens({PIN_VARIABLE: "for other tokens"}, lambda text: asked.append(text) or SECRET)
    assert pins.pin("ca", "", "CA_PIN") == SECRET
    assert asked == ["PIN of the token ca: "]


@pytest.mark.parametrize("ask", [None, lambda _text: ""])
def test_no_pin_at_all(ask: object) -> None:
    with pytest.raises(KeymintError, match="CA_PIN, which holds the PIN of the token ca, is not set") as error:
        Tokens({PIN_VARIABLE: "for other tokens"}, ask).pin("ca", "", "CA_PIN")
    assert error.value.diagnostics[0].code == PIN_MISSING


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o666, 0o611])
def test_a_file_that_others_may_use_is_refused(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "pin"
    file.write_text(SECRET)
    file.chmod(mode)
    refused(file, f"has mode {mode:04o}")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is not one line"),
        (b"\n", "is not one line"),
        (b"1234\n5678\n", "is not one line"),
        (b"1" * 256, "is not one line"),
        (b"12\xff34", "is not UTF-8"),
    ],
)
def test_a_file_without_a_pin_is_refused(tmp_path: Path, content: bytes, problem: str) -> None:
    file = tmp_path / "pin"
    file.write_bytes(content)
    file.chmod(0o600)
    refused(file, problem)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "pin", "No such file")
    (tmp_path / "target").write_text(SECRET)
    (tmp_path / "target").chmod(0o600)
    (tmp_path / "pin").symlink_to("target")
    refused(tmp_path / "pin", "cannot be read")
    os.mkfifo(tmp_path / "fifo", 0o600)
    refused(tmp_path / "fifo", "is not a regular file")
    refused(tmp_path, "Is a directory")


def test_a_file_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "pin"
    file.write_text(SECRET)
    file.chmod(0o600)
    if os.geteuid() == 0:
        os.chown(file, 12345, -1)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
    refused(file, "belongs to another user")


def test_no_pin_is_shown() -> None:
    assert SECRET not in repr(Tokens({PIN_VARIABLE: SECRET}))


def refused(file: Path, problem: str) -> None:
    with pytest.raises(KeymintError) as error:
        Tokens({PIN_VARIABLE: SECRET}, never).pin("ca", str(file), "")
    (found,) = error.value.diagnostics
    assert found.code == PIN_REFUSED
    assert problem in found.message
    assert "4711" not in str(found)
