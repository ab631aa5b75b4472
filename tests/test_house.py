# SPDX-License-Identifier: Apache-2.0
"""The project does not grow by habit: budgets that may fall and never rise, counted as ``benchmarks/house.py`` does.

Whoever lowers a number lowers its budget. A change that must raise one says why in its commit.
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from benchmarks import house

FILES_IN_A_FOLDER, FILES_IN_KEYMINT = 20, 8
CODE_LINES, DATA_TYPES, PROTOCOLS = 46_560, 351, 0
CONDUCTORS, JUDGES, DOUBLED_NAMES = 1, 0, 0


@pytest.fixture(scope="module")
def modules() -> Sequence[house.Module]:
    found = house.house()
    if not found:
        pytest.skip("the sources are elsewhere")
    return found


def test_lines_of_code(modules: Sequence[house.Module]) -> None:
    assert house.code_lines(modules) <= CODE_LINES


def test_files_in_a_folder(modules: Sequence[house.Module]) -> None:
    folders = house.files_by_folder(modules)
    assert {folder: count for folder, count in folders.items() if count > FILES_IN_A_FOLDER} == {}
    assert folders["keymint"] <= FILES_IN_KEYMINT


def test_types(modules: Sequence[house.Module]) -> None:
    assert house.data_types(modules) <= DATA_TYPES
    assert house.protocols(modules) <= PROTOCOLS


def test_names_of_classes(modules: Sequence[house.Module]) -> None:
    doubled = house.doubled_classes(modules)
    assert len(doubled) <= DOUBLED_NAMES, doubled


def test_places_that_conduct_the_stages(modules: Sequence[house.Module]) -> None:
    assert {"BuildStage", "InstallStage"} <= set(house.stages_of(modules)), "the rule must know their new names"
    conducting = house.conducting(modules)
    assert len(conducting) <= CONDUCTORS, conducting


def test_modules_that_judge_installed_files(modules: Sequence[house.Module]) -> None:
    judging = house.judging(modules)
    assert len(judging) <= JUDGES, judging


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ('"""A docstring\n\nof three lines."""\n', 0),
        ("# a comment\n\nx = 1  # another\n", 1),
        ('def f():\n    """Say."""\n    return """two\nlines"""\n', 3),
    ],
)
def test_lines_are_counted_without_comments_and_docstrings(text: str, lines: int) -> None:
    assert house.code_lines([house.Module("keymint/x.py", text)]) == lines


def test_a_conductor_is_seen() -> None:
    stages = "class BuildStage: ...\nclass InstallStage: ...\n"
    conductor = "def plan():\n    return InstallStage()\n"
    asking = "def stale():\n    return BuildStage()\n"
    modules = [
        house.Module(f"keymint/{name}.py", text) for name, text in zip("abc", (stages, conductor, asking), strict=True)
    ]
    assert house.conducting(modules) == ["keymint/b.py"]


def test_a_judge_is_seen_outside_of_its_room() -> None:
    text = "def judge():\n    return Diagnostic.error('key-mismatch', 'is another key')\n"
    modules = [house.Module(path, text) for path in ("keymint/examine/keys.py", "keymint/plan/keys.py")]
    assert house.judging(modules) == ["keymint/plan/keys.py"]
