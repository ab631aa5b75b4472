# SPDX-License-Identifier: Apache-2.0
"""Damaged policies are errors with a place, never a traceback; and what can be read is translated and proven."""

from __future__ import annotations

from pathlib import Path
from random import Random

from keymint_ros2_sros2 import policy_type

from comarmor.data import locate
from comarmor.errors import ComArmorError
from keymint.api import ImportRequest
from tests.effort import tries

from .sros2_policies import COMMON, ROBOT

LIBRARY = locate("keymint_ros", "templates") / "comarmor.d" / "foxy"
PIECES = (
    "<", ">", "/", '"', "&amp;", "~", "*", "[", "]", "{", "\\", " ", "\n", "0", "xpointer(/", "<!-- c -->", "<topics/>",
    "<profiles/>", "<metadata>", "</enclave>", "ALLOW", 'path="/"', "xi:include", "\u00e9", "<topic>~x</topic>",
)  # fmt: skip


def damaged(text: str, chance: Random) -> str:
    if chance.random() < 0.5:  # a name alone
        at = chance.choice([text.index(name) for name in ("chatter", "/*<", "add<", "dock") if name in text] or [0])
        return text[:at] + chance.choice("~/*?[]{}@! a") + text[at:]
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(text))
        end = at + chance.choice((0, 0, 1, 8, 40))
        text = text[:at] + chance.choice(PIECES) + text[end:]
    return text


def test_damaged_policies(write, tmp_path: Path) -> None:
    refused = read = 0
    for seed in range(tries(100, 5000)):
        chance = Random(seed)
        files = {
            name: content if chance.random() < 0.9 else damaged(content, chance) for name, content in COMMON.items()
        }
        path = write(damaged(ROBOT, chance), files)
        policy_type.recognises(path)
        try:
            found = policy_type.translated(ImportRequest(path, "new.xml", LIBRARY, accept=chance.random() < 0.5))
        except ComArmorError as error:
            refused += all(
                each.where is not None and each.where.file.startswith(str(tmp_path)) for each in error.diagnostics
            )
        else:
            read += bool(found.subjects)
    assert refused + read == tries(100, 5000)
    assert min(refused, read) > tries(100, 5000) / 20
