# SPDX-License-Identifier: Apache-2.0
"""Print how many things the code consists of, next to what it must become: the table of the architecture's budgets.

usage: python benchmarks/house.py [REV...]

Without a revision the working tree is counted, which ``.`` names beside others; several revisions stand side by side
(each is unpacked by ``git archive`` into a temporary folder). Only ``comarmor``, ``keymint`` and ``plugins`` count.
``tests/test_architecture.py`` holds numbers of it as budgets that may fall and never rise.

What the rows count:

code lines
    Lines with a token that is no comment, and that belong to no docstring.
places that conduct the stages
    Modules, apart from the conductor ``keymint/stages/pipeline.py``, that name the stage which installs, or two
    stages or more, and do not define them. Installing needs that something was built before, so whoever installs
    decides an order. A stage is a class whose name ends with ``Stage``; ``PackageStage`` is their base.
modules that judge installed files
    Modules outside of the rooms for it (folders and files named ``examine``) that name one of the findings about
    installed files (:data:`JUDGEMENTS`).
own names that are a bare participle or preposition
    Public names of functions and values of a module that are one word: a preposition, or a participle (or an adjective
    in *-able*) by its ending or by the list of irregular ones. Only the word is seen, not what a reader makes of it.
modules and functions that run, depth
    Of a first ``keymint provision`` of the two enclaves of ``examples/talker_listener``, under :func:`sys.setprofile`.
    The depth is the greatest number of own functions on the stack of one thread.

*Data types that a rule passes* and *functions in reach of one file write* are not counted: both need a judgement of
which calls a value follows, which a script cannot make honestly.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parent.parent
ROOTS = ("comarmor", "keymint", "plugins")
CONDUCTOR = "keymint/stages/pipeline.py"
MEMOS = {"cache", "cached", "cached_property", "lru_cache", "once", "once_of_sources"}
DATA_TYPES = {"Data", "NamedTuple", "TypedDict"}
_JUDGEMENTS = """
authorities-differ authority-differs authority-drift authority-expired authority-expires authority-key-mismatch
authority-key-shared authority-shared bundle-authority bundle-outdated bundle-unexpected certificate-drift
certificate-expired certificate-expires certificate-outlives-authority certificate-revoked certificate-subject
certificate-unregistered document-differs document-hazard enclave-ignored enclave-orphaned file-link file-mode
file-owner file-replaced file-unexpected folder-unexpected governance-weaker grant-count grant-default grant-expired
grant-expires grant-outlives-authority grant-subject key-exposed key-mismatch key-of-authority key-plain key-replaced
key-shared key-uri key-was-exposed names-confused pem-altered revocation-list-expired revocation-list-living
revocation-list-outdated rights-outlive smime-authority-expired zenoh-signature adopt-authorities adopt-doubled
adopt-file-missing adopt-grants adopt-key-exposed adopt-key-mismatch adopt-key-shared adopt-policy adopt-revoked
adopt-token
"""
JUDGEMENTS = frozenset(_JUDGEMENTS.split())
"""Codes of findings about the content or the state of installed files.

Not among them are the codes that readers of sources use, too, and ``file-changed``, which a verb says of any file that
changes while it is read.
"""
_PREPOSITIONS = """
about above after against at before below beside between by for from in into of off on over per since than through to
under until up upon via with within without
"""
PREPOSITIONS = frozenset(_PREPOSITIONS.split())
_IRREGULAR = """
begun bound bought broken brought built chosen cut done drawn driven found given gone grown held kept known left lent
lost made meant met put said seen sent set shown shut sold spent split spoken stood taken taught thought told
understood won worn written
"""
IRREGULAR = frozenset(_IRREGULAR.split())
"""Not ``read``: as the name of a function it is the imperative."""
NOT_PARTICIPLES = {
    "embed",
    "feed",
    "need",
    "red",
    "seed",
    "speed",
    "string",
    "ring",
    "thing",
    "spring",
    "king",
    "setting",
}


@dataclass(frozen=True)
class Module:
    """A module of the project.

    Attributes:
        path: path from the root of the checkout.
        text: the source.
    """

    path: str
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax."""
        return ast.parse(self.text)

    @cached_property
    def lines(self) -> frozenset[int]:
        """The numbers of the lines of code."""
        documented = {
            line
            for node in ast.walk(self.tree)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            for line in _docstring_lines(node.body)
        }
        blank = {
            tokenize.COMMENT,
            tokenize.NL,
            tokenize.NEWLINE,
            tokenize.INDENT,
            tokenize.DEDENT,
            tokenize.ENDMARKER,
        }
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        code = (range(each.start[0], each.end[0] + 1) for each in tokens if each.type not in blank)
        return frozenset(line for lines in code for line in lines) - documented

    @cached_property
    def classes(self) -> Sequence[ast.ClassDef]:
        """The classes, nested ones included."""
        return [node for node in ast.walk(self.tree) if isinstance(node, ast.ClassDef)]

    def folder(self) -> str:
        """Return the folder of the module."""
        return str(Path(self.path).parent)


def _docstring_lines(body: Sequence[ast.stmt]) -> range:
    first = body[0] if body else None
    if (
        isinstance(first, ast.Expr)
        and isinstance(first.value, ast.Constant)
        and isinstance(first.value.value, str)
        and first.end_lineno is not None
    ):
        return range(first.lineno, first.end_lineno + 1)
    return range(0)


def house(root: Path = CHECKOUT) -> Sequence[Module]:
    """Return the modules below a checkout, by path."""
    paths = sorted(path for name in ROOTS for path in (root / name).rglob("*.py"))
    return [Module(str(path.relative_to(root)), path.read_text(encoding="utf-8")) for path in paths]


# -- what is counted -----------------------------------------------------------------------------------------------


def code_lines(modules: Sequence[Module]) -> int:
    """Return the number of lines of code."""
    return sum(len(module.lines) for module in modules)


def import_share(modules: Sequence[Module]) -> float:
    """Return the share of lines of code that are imports."""
    imports = 0
    for module in modules:
        nodes = [node for node in ast.walk(module.tree) if isinstance(node, ast.Import | ast.ImportFrom)]
        of_imports = {line for node in nodes for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
        imports += len(of_imports & module.lines)
    return imports / code_lines(modules)


def with_code(modules: Sequence[Module]) -> int:
    """Return the number of modules that have code."""
    return sum(bool(module.lines) for module in modules)


def data_types(modules: Sequence[Module]) -> int:
    """Return the number of data classes and named tuples."""
    return sum(
        "dataclass" in _names(node.decorator_list) or bool(DATA_TYPES & _names(node.bases))
        for module in modules
        for node in module.classes
    )


def enumerations(modules: Sequence[Module]) -> int:
    """Return the number of enumerations."""
    return sum(
        any(name.endswith(("Enum", "Flag")) for name in _names(node.bases))
        for module in modules
        for node in module.classes
    )


def protocols(modules: Sequence[Module]) -> int:
    """Return the number of protocols."""
    return sum("Protocol" in _names(node.bases) for module in modules for node in module.classes)


def memo_decorators(modules: Sequence[Module]) -> int:
    """Return the number of functions that remember what they returned."""
    functions = (node for module in modules for node in ast.walk(module.tree) if isinstance(node, ast.FunctionDef))
    return sum(bool(MEMOS & _names(node.decorator_list)) for node in functions)


def _names(nodes: Sequence[ast.expr]) -> set[str]:
    """Return the last names of expressions such as ``functools.cache`` and ``Protocol[T]``."""
    found = set()
    for node in nodes:
        while isinstance(node, ast.Call | ast.Subscript):
            node = node.func if isinstance(node, ast.Call) else node.value  # noqa: PLW2901
        found.add(node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", ""))
    return found


def files_by_folder(modules: Sequence[Module]) -> Mapping[str, int]:
    """Return the number of modules directly in each folder; the marker of a package does not count."""
    return Counter(module.folder() for module in modules if not module.path.endswith("/__init__.py"))


def stages_of(modules: Sequence[Module]) -> Collection[str]:
    """Return the names of the classes of stages; if they are renamed, the rule of :func:`conducting` must follow."""
    names = {node.name for module in modules for node in module.classes if node.name.endswith("Stage")}
    return names - {"PackageStage"}


def conducting(modules: Sequence[Module]) -> Sequence[str]:
    """Return the modules that conduct the stages; see the rule above."""
    stages = set(stages_of(modules))
    found = []
    for module in modules:
        used = {node.id for node in ast.walk(module.tree) if isinstance(node, ast.Name)}
        used |= {node.attr for node in ast.walk(module.tree) if isinstance(node, ast.Attribute)}
        used = (used & stages) - {node.name for node in module.classes}
        if module.path != CONDUCTOR and ("InstallStage" in used or len(used) > 1):
            found.append(module.path)
    return found


def judging(modules: Sequence[Module]) -> Sequence[str]:
    """Return the modules that judge installed files; see the rule above."""
    return [
        module.path
        for module in modules
        if "examine" not in module.path.removesuffix(".py").split("/") and JUDGEMENTS & set(_texts(module.tree))
    ]


def _texts(tree: ast.Module) -> Iterator[str]:
    return (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))


def doubled_classes(modules: Sequence[Module]) -> Sequence[str]:
    """Return the names that several classes have."""
    seen = Counter(node.name for module in modules for node in module.classes)
    return sorted(name for name, count in seen.items() if count > 1)


def bare_names(modules: Sequence[Module]) -> Sequence[str]:
    """Return the public names of modules that are a bare participle or preposition, each with its module."""
    return sorted(
        f"{module.path}:{name}" for module in modules for name in set(_defined(module.tree)) if _is_bare(name)
    )


def _defined(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name
            case ast.Assign(targets=targets):
                yield from (target.id for target in targets if isinstance(target, ast.Name))
            case ast.AnnAssign(target=ast.Name(id=name)):
                yield name


def _is_bare(name: str) -> bool:
    by_ending = re.fullmatch(r"[a-z]+(ed|ing|able)", name) is not None and name not in NOT_PARTICIPLES
    return by_ending or name in PREPOSITIONS or name in IRREGULAR


def contracts(root: Path) -> str:
    """Return how many of the import contracts are broken, circles among them; *unknown* without import-linter."""
    command = Path(sys.executable).with_name("lint-imports")
    if not command.exists():
        return "unknown"
    done = subprocess.run(
        [command, "--no-cache"], cwd=root, env=_environment(root), capture_output=True, text=True, check=False
    )
    found = re.search(r"Contracts: (\d+) kept, (\d+) broken", done.stdout)
    return f"{found[2]} of {int(found[1]) + int(found[2])}" if found else "unknown"


# -- what runs -----------------------------------------------------------------------------------------------------

TRACED = """
import json, sys, threading
from pathlib import Path
own, ran, depths, deepest = tuple(f"{sys.argv[1]}/{name}/" for name in sys.argv.pop(2).split()), set(), {}, 0
del sys.argv[1]

def profile(frame, event, _):
    global deepest
    code = frame.f_code
    if event not in ("call", "return") or not code.co_flags & 1 or not code.co_filename.startswith(own):
        return  # modules and bodies of classes have no fast locals
    thread = threading.get_ident()
    depths[thread] = depths.get(thread, 0) + (1 if event == "call" else -1)
    if event == "call":
        deepest = max(deepest, depths[thread])
        ran.add(code)

threading.setprofile(profile)
sys.setprofile(profile)
from keymint.__main__ import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
sys.setprofile(None)
files = {Path(file) for module in list(sys.modules.values()) if (file := getattr(module, "__file__", None))}
print(json.dumps({
    "modules that run": len({code.co_filename for code in ran}),
    "functions that run": len(ran),
    "deepest stack": deepest,
    "modules imported": sum(str(file).startswith(own) for file in files),
}), file=sys.stderr)
"""


def running(root: Path) -> Mapping[str, int]:
    """Return what a first provision of two enclaves runs."""
    with tempfile.TemporaryDirectory(prefix="keymint-house-") as folder:
        return traced(root, Path(folder), *FIRST)


FIRST = ("provision", str(CHECKOUT / "examples/talker_listener"), "-w", "ws")


def traced(root: Path, folder: Path, *arguments: str) -> Mapping[str, int]:
    """Return what a command runs in a folder."""
    done = subprocess.run(
        [sys.executable, "-c", TRACED, str(root), " ".join(ROOTS), *arguments],
        cwd=folder,
        env=_environment(root),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        sys.exit(f"{arguments[0]} ended with {done.returncode}: {done.stderr[-2000:]}")
    counted: dict[str, int] = json.loads(done.stderr.splitlines()[-1])
    return counted


def _environment(root: Path) -> Mapping[str, str]:
    """Return an environment in which the modules of a checkout are imported, not the installed ones."""
    return {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{root / 'plugins'}"}


# -- the table -----------------------------------------------------------------------------------------------------

WANTED = {
    "code lines": "≤ 45,000, wanted 42,000",
    "places that conduct the stages": "1, the conductor",
    "modules that judge installed files": "0",
    "files in the fullest folder": "≤ 20",
    "files in keymint/": "≤ 8",
    "import contracts broken": "0",
    "class names that occur twice": "0",
    "bare participles and prepositions": "0",
}
"""What the rows must become; the others are reported."""


def figures(root: Path) -> Mapping[str, int | float | str]:
    """Return the rows of the table for a checkout."""
    modules = house(root)
    folders = files_by_folder(modules)
    fullest = max(folders, key=lambda folder: folders[folder])
    return {
        "code lines": code_lines(modules),
        "places that conduct the stages": len(conducting(modules)) + (root / CONDUCTOR).exists(),
        "modules that judge installed files": len(judging(modules)),
        "files in the fullest folder": f"{folders[fullest]} ({fullest})",
        "files in keymint/": folders["keymint"],
        "import contracts broken": contracts(root),
        "class names that occur twice": len(doubled_classes(modules)),
        "bare participles and prepositions": len(bare_names(modules)),
        "share of imports": f"{import_share(modules):.1%}",
        "modules with code": with_code(modules),
        "data types": data_types(modules),
        "enumerations": enumerations(modules),
        "protocols": protocols(modules),
        "memo decorators": memo_decorators(modules),
        **running(root),
    }


def _unpacked(revision: str, folder: Path) -> Path:
    if revision == ".":
        return CHECKOUT
    archive = subprocess.run(["git", "archive", revision], cwd=CHECKOUT, capture_output=True, check=False)
    if archive.returncode:
        sys.exit(archive.stderr.decode().strip())
    folder.mkdir()
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive.stdout, check=True)
    return folder


def table(columns: Mapping[str, Mapping[str, int | float | str]]) -> Iterator[str]:
    """Yield the lines of the table; a row without a must is reported only."""
    yield _row(["", *columns, "must"])
    yield _row(["---"] * (len(columns) + 2))
    rows: Collection[str] = next(iter(columns.values()))
    for row in rows:
        values = (column[row] for column in columns.values())
        yield _row(
            [row, *(f"{each:,}" if isinstance(each, int) else str(each) for each in values), WANTED.get(row, "")]
        )


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revisions", nargs="*", metavar="REV", help="a revision of git; default: the working tree")
    revisions: Sequence[str] = parser.parse_args().revisions
    if not revisions:
        print(*table({"now": figures(CHECKOUT)}), sep="\n")
        return
    with tempfile.TemporaryDirectory(prefix="keymint-house-") as folder:
        columns = {each: figures(_unpacked(each, Path(folder, str(at)))) for at, each in enumerate(revisions)}
    print(*table(columns), sep="\n")


if __name__ == "__main__":
    main()
