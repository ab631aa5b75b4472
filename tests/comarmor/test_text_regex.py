# SPDX-License-Identifier: Apache-2.0
"""Regular expressions that are compiled late are those of the standard library."""

from __future__ import annotations

import copy
import pickle
import re
import subprocess
import sys

import pytest

from comarmor.text import lazy_regex
from tests.conftest import CHECKOUT


def test_a_late_regular_expression_does_what_an_early_one_does() -> None:
    early, late = re.compile("(a+)(?P<end>b)?", re.IGNORECASE), lazy_regex("(a+)(?P<end>b)?", re.IGNORECASE)
    for text in ("", "aab", "AAc", "xaab"):
        for method in ("match", "fullmatch", "search"):
            found, expected = getattr(late, method)(text), getattr(early, method)(text)
            assert (found and found.groupdict()) == (expected and expected.groupdict())
        assert late.sub("<\\1>", text) == early.sub("<\\1>", text)
    assert (late.pattern, late.flags, dict(late.groupindex)) == (early.pattern, early.flags, {"end": 2})
    assert lazy_regex(b"a").fullmatch(b"a")


@pytest.mark.parametrize("used", [True, False])
def test_it_can_be_copied_and_pickled(used: bool) -> None:
    late = lazy_regex("a+", re.IGNORECASE)
    if used:
        late.match("")
    for other in (copy.copy(late), copy.deepcopy(late), pickle.loads(pickle.dumps(late))):
        assert other.fullmatch("aA")


def test_a_mistake_is_an_error_at_the_first_use() -> None:
    broken = lazy_regex("(")
    with pytest.raises(re.error):
        broken.match("")


_COMPILE_ALL = """
import importlib, pathlib, sys
from comarmor import text
made = []
init = text._Regex.__init__
text._Regex.__init__ = lambda self, *arguments: made.append(self) or init(self, *arguments)
for file in [each for each in map(pathlib.Path, sys.argv[1:]) if "lazy_regex(" in each.read_text()]:
    path = file.relative_to("plugins") if file.parts[0] == "plugins" else file
    try:
        importlib.import_module(".".join(path.with_suffix("").parts).removesuffix(".__init__"))
    except ModuleNotFoundError as error:
        assert error.name.split(".")[0] not in ("comarmor", "keymint"), error
print(len([each.pattern for each in made]))
"""


def test_all_regular_expressions_of_the_program_compile() -> None:
    files = [
        str(each.relative_to(CHECKOUT))
        for top in ("comarmor", "keymint", "plugins")
        for each in CHECKOUT.joinpath(top).rglob("*.py")
    ]
    command = [sys.executable, "-c", _COMPILE_ALL, *files]
    run = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) > 90
