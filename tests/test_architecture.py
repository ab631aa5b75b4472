# SPDX-License-Identifier: Apache-2.0
"""Rules of the architecture that no linter can check: slow imports, budgets, and what may be committed."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from benchmarks import house

CHECKOUT = Path(__file__).resolve().parent.parent

# -- speed --------------------------------------------------------------------------------------------------------

SLOW = {
    "lxml",
    "cryptography",
    "rich",
    "jinja2",
    "xmlschema",
    "networkx",
    "isodate",
    "comarmor.language",
    "dataclasses",
    "importlib.metadata",
}


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_imports_nothing_slow(option: str) -> None:
    script = (
        "import sys\n"
        f"sys.argv = ['keymint', {option!r}]\n"
        "from keymint.__main__ import main\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n    assert not end.code, end.code\n"
        "import json\n"
        "print(json.dumps(sorted(sys.modules)), file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=CHECKOUT, capture_output=True, text=True, check=True, env=_environment()
    )
    assert "keymint" in done.stdout
    assert set(json.loads(done.stderr)) & SLOW == set()


def test_packages_and_policies_are_read_without_modules_for_networks() -> None:
    """The helpers of xml.sax that escape texts load them."""
    script = (
        "import sys, comarmor.language.loading, keymint_ros2_table.policy, keymint_ros2_sros2.translate\n"
        "import keymint_ros.package_writer, keymint_ros.package_reader\n"
        "print({'http.client', 'ssl', 'urllib.request'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=CHECKOUT, capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def _environment() -> Mapping[str, str]:
    return {"PYTHONPATH": str(CHECKOUT), "PATH": "/usr/bin:/bin"}


# -- one conductor -------------------------------------------------------------------------------------------------

STAGES = {"CreateStage", "BuildStage", "InstallStage", "ProofStage"}


def modules() -> Iterator[tuple[str, ast.Module]]:
    """Yield the modules of the packages, each with its path."""
    for path in sorted([*CHECKOUT.glob("keymint/**/*.py"), *CHECKOUT.glob("plugins/**/*.py")]):
        yield str(path.relative_to(CHECKOUT)), ast.parse(path.read_text())


def named(tree: ast.AST) -> set[str]:
    return {
        each.id if isinstance(each, ast.Name) else each.attr
        for each in ast.walk(tree)
        if isinstance(each, ast.Name | ast.Attribute)
    }


def test_data_types_describe_their_fields_by_the_function_of_their_module() -> None:
    """What the function of the standard library returns, they would take for a default."""

    def imported(tree: ast.AST, module: str) -> set[str]:
        found = (each for each in ast.walk(tree) if isinstance(each, ast.ImportFrom) and each.module == module)
        return {alias.name for each in found for alias in each.names}

    both = [
        path
        for path, tree in modules()
        if "field" in imported(tree, "dataclasses") and "Data" in imported(tree, "comarmor.values")
    ]
    assert both == []


def test_one_module_knows_the_order_of_the_stages() -> None:
    using = {path: STAGES & named(tree) for path, tree in modules()}
    assert [path for path, stages in using.items() if stages and not path.startswith("keymint/stages/")] == []
    assert [path for path, stages in using.items() if len(stages) > 1] == ["keymint/stages/pipeline.py"]


def test_one_module_adds_a_plan_and_takes_it_into_account() -> None:
    """Elsewhere one of the two could be forgotten."""

    def given(tree: ast.AST, method: str) -> set[str]:
        calls = (each for each in ast.walk(tree) if isinstance(each, ast.Call) and isinstance(each.func, ast.Attribute))
        return {ast.unparse(each.args[0]) for each in calls if each.func.attr == method and len(each.args) == 1}

    functions = (
        (path, each) for path, tree in modules() for each in ast.walk(tree) if isinstance(each, ast.FunctionDef)
    )
    assert [f"{path}: {each.name}" for path, each in functions if given(each, "then") & given(each, "after")] == []


# -- budgets: the project does not grow by habit ----------------------------------------------------------------------

# They may fall and never rise, and are counted as ``benchmarks/house.py`` does. Whoever lowers a number lowers its
# budget. A change that must raise one says why in its commit.
FILES_IN_A_FOLDER, FILES_IN_KEYMINT = 20, 8
CODE_LINES, DATA_TYPES, PROTOCOLS = 46_596, 344, 0
IMPORTED = {"--version": 12, "provision": 178, "status": 133}
CONDUCTORS, JUDGES, DOUBLED_NAMES, BARE_NAMES = 1, 0, 0, 0


@pytest.fixture(scope="module")
def counted() -> Sequence[house.Module]:
    found = house.house()
    if not found:
        pytest.skip("the sources are elsewhere")
    return found


def test_lines_of_code(counted: Sequence[house.Module]) -> None:
    assert house.code_lines(counted) <= CODE_LINES


def test_modules_that_a_run_imports(tmp_path: Path) -> None:
    """Each takes 0.2 ms: a run of two enclaves spends most of its time on imports."""
    commands = (("--version",), house.FIRST, ("status", "-w", "ws"))
    found = {each[0]: house.traced(CHECKOUT, tmp_path, *each)["modules imported"] for each in commands}
    assert {command: number for command, number in found.items() if number > IMPORTED[command]} == {}


def test_files_in_a_folder(counted: Sequence[house.Module]) -> None:
    folders = house.files_by_folder(counted)
    assert {folder: count for folder, count in folders.items() if count > FILES_IN_A_FOLDER} == {}
    assert folders["keymint"] <= FILES_IN_KEYMINT


def test_types(counted: Sequence[house.Module]) -> None:
    assert house.data_types(counted) <= DATA_TYPES
    assert house.protocols(counted) <= PROTOCOLS


def test_names_of_classes(counted: Sequence[house.Module]) -> None:
    doubled = house.doubled_classes(counted)
    assert len(doubled) <= DOUBLED_NAMES, doubled


def test_names_say_what_they_stand_for(counted: Sequence[house.Module]) -> None:
    bare = house.bare_names(counted)
    assert len(bare) <= BARE_NAMES, bare


def test_places_that_conduct_the_stages(counted: Sequence[house.Module]) -> None:
    assert {"BuildStage", "InstallStage"} <= set(house.stages_of(counted)), "the rule must know their new names"
    conducting = house.conducting(counted)
    assert len(conducting) <= CONDUCTORS, conducting


def test_modules_that_judge_installed_files(counted: Sequence[house.Module]) -> None:
    judging = house.judging(counted)
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


# -- the project's files ------------------------------------------------------------------------------------------

SOMEONES_MACHINE = re.compile(r"(?<![\w.*})/])/(?:root|work|(?:home|Users)/(?!me\b)\w+|opt/\w+venv)(?:/|\b)")
"""Folders that only the machine has on which something was written."""


def project_files() -> list[Path]:
    """Return the files that are, or are about to be, under version control."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=CHECKOUT,
        capture_output=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("this is not a checkout of git")
    return [path for name in listed.stdout.decode().split("\0") if name and (path := CHECKOUT / name).is_file()]


def test_no_file_names_a_place_of_somebodys_machine() -> None:
    found = [
        f"{path.relative_to(CHECKOUT)}:{number}: {line.strip()}"
        for path in project_files()
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1)
        if SOMEONES_MACHINE.search(line)
    ]
    assert found == []


def test_a_place_of_somebodys_machine_is_seen() -> None:
    for top in ("home", "Users", "root", "work"):
        assert SOMEONES_MACHINE.search(f"see /{top}/someone/notes.md")
    for name in (
        "my_ws/work/x",
        "/home/me/ws",
        "/workspace/x",
        "../shared/reference",
        "/opt/ros/jazzy/lib",
        "https://host/work/x",
    ):
        assert not SOMEONES_MACHINE.search(name)


def test_every_source_file_names_its_licence() -> None:
    sources = [path for path in project_files() if path.suffix in {".py", ".c", ".cpp"}]
    assert len(sources) > 400
    assert [path for path in sources if "SPDX-License-Identifier: Apache-2.0" not in path.read_text()[:200]] == []
