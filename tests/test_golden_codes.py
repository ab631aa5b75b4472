# SPDX-License-Identifier: Apache-2.0
"""The codes of findings and errors are stable: a list of all, and a list of those that were removed or renamed.

A code stands where a call gives it: as ``code=...``, or in the place of a parameter ``code``. If the call gives a
variable ``code``, every literal of its file that reads as a code counts as one. A table lists the values of f-strings.
"""

from __future__ import annotations

import ast
import itertools
import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pytest

from keymint.output.explanations import explanations
from tests.conftest import CHECKOUT

SOURCES = sorted(path for folder in ("comarmor", "keymint", "plugins") for path in (CHECKOUT / folder).rglob("*.py"))
LISTED = Path(__file__).with_name("golden_codes.txt")
REMOVED = Path(__file__).with_name("golden_codes_removed.txt")


def each_of(*parts: str) -> set[str]:
    """Return the codes of which each part is one of several words: ``each_of("grant crl", "expired")``."""
    return {"-".join(words) for words in itertools.product(*(part.split() for part in parts))}


_DATED = "authority certificate grant revocation-list"
F_STRINGS = {
    "f'{term.code}-{code}'": each_of(_DATED, "expired not-yet-valid never-valid"),
    "f'{term.code}-expires'": each_of("authority", "expires"),
    "f'{each.what}-outlives-authority'": each_of("authority certificate grant", "outlives-authority"),
    "f'{code}-expired'": each_of("certificate grant revocation-list", "expired"),
    "f'{code}-not-yet-valid'": each_of("certificate grant revocation-list", "not-yet-valid"),
    "f'{code}-expires'": each_of("certificate grant revocation-list", "expires"),
    "f'{owner}-incomplete'": each_of("certificate grant", "incomplete"),
    "f'size-{kind}'": each_of("size", "governance permissions"),
    "f'unknown-{what}'": each_of("unknown", "kind permission"),
    "str(first.error)": each_of("false", "negative positive"),
}
"""The f-strings and the calls that give codes, and their values."""
NO_CODES = {"32", "expired", "keymint-graph", "keymint-tools", "ls-files", "not-yet-valid", "python-pkcs11"}
NO_CODES |= {"slot-description", "slot-id", "slot-manufacturer", "utf-8", "utf-8-sig"}
"""Literals in the files of variables, and parts of codes, which look like codes."""

_CODE = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)*")
_CODE_PART = re.compile(r"[a-z0-9-]+")
_DIAGNOSTICS = {"Diagnostic", "error", "warning", "note"}
_Places = Mapping[str, Collection[int]]
"""The functions of a module by name, each with the places of a code among its arguments."""


def literals(tree: ast.AST) -> set[str]:
    """Return the texts that read as codes."""
    texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return {text for text in texts if _CODE.fullmatch(text)}


def functions(tree: ast.Module) -> _Places:
    """Return the functions of a module; a class stands for its constructor."""
    found: dict[str, set[int]] = defaultdict(set)
    for node in ast.walk(tree):
        for each in node.body if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.Module) else ():
            if isinstance(each, ast.FunctionDef):
                arguments = [*each.args.posonlyargs, *each.args.args]
                is_method = bool(arguments) and arguments[0].arg in {"self", "cls"}
                texts = [each.arg for each in arguments if each.annotation and ast.unparse(each.annotation) == "str"]
                names = [each.arg for each in arguments]
                name = node.name if each.name == "__init__" and isinstance(node, ast.ClassDef) else each.name
                found[name] |= {names.index("code") - is_method} if "code" in texts else set()
    return found


def given(tree: ast.Module, elsewhere: _Places) -> Iterator[ast.expr]:
    """Yield the expressions of a module that give a code."""
    own = functions(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = str(getattr(node.func, "attr", getattr(node.func, "id", "")))
            places = [0] if name in _DIAGNOSTICS else own[name] if name in own else elsewhere.get(name, ())
            yield from (keyword.value for keyword in node.keywords if keyword.arg == "code")
            yield from (node.args[place] for place in places if place < len(node.args))
        elif isinstance(node, ast.FunctionDef):
            names = [each.arg for each in (*node.args.posonlyargs, *node.args.args)][::-1]
            defaults = [*zip(names, node.args.defaults[::-1], strict=False)]
            defaults += zip((each.arg for each in node.args.kwonlyargs), node.args.kw_defaults, strict=True)
            yield from (value for name, value in defaults if name == "code" and value)


def constants(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield the constants of a module that read as codes: name and value."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            target = node.targets[0]
            is_pair = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            pairs = zip(target.elts, node.value.elts, strict=True) if is_pair else [(target, node.value)]
            for name, value in pairs:
                if isinstance(name, ast.Name) and isinstance(value, ast.Constant):
                    yield from ((name.id, text) for text in literals(value))


def values(expression: ast.expr, tree: ast.Module, known: Mapping[str, set[str]]) -> set[str]:
    """Return the codes that an expression can give.

    Raises:
        KeyError: it is an f-string that the table lacks.
    """
    name = str(getattr(expression, "attr", getattr(expression, "id", "")))
    match expression:
        case ast.Constant():
            return literals(expression)
        case ast.IfExp():
            return values(expression.body, tree, known) | values(expression.orelse, tree, known)
        case ast.JoinedStr(parts) if all(
            _CODE_PART.fullmatch(each.value) for each in parts if isinstance(each, ast.Constant)
        ):
            return F_STRINGS[ast.unparse(expression)]
        case ast.Name() | ast.Attribute() if name in known:
            return known[name]
        case ast.Name() if name == "code":
            return {text for text in literals(tree) if "-" in text}
    return F_STRINGS.get(ast.unparse(expression), set())


def codes_in(sources: Mapping[str, str]) -> dict[str, set[str]]:
    """Return the codes of some files, by name and content; each with its files."""
    trees = {name: ast.parse(content) for name, content in sources.items()}
    elsewhere: dict[str, set[int]] = defaultdict(set)
    known: dict[str, set[str]] = defaultdict(set)
    for tree in trees.values():
        for name, places in functions(tree).items():
            elsewhere[name].update(places)
        for name, value in constants(tree):
            known[name].add(value)
    found: dict[str, set[str]] = defaultdict(set)
    for name, tree in trees.items():
        for expression in given(tree, elsewhere):
            for code in values(expression, tree, known) - NO_CODES:
                found[code].add(name)
    return found


def all_codes() -> dict[str, set[str]]:
    """Return all codes of the project, each with its files."""
    return codes_in({path.relative_to(CHECKOUT).as_posix(): path.read_text() for path in SOURCES})


def test_every_code_is_listed_and_every_listed_code_exists() -> None:
    found = all_codes()
    listed = LISTED.read_text().splitlines()
    removed = set(REMOVED.read_text().splitlines())
    assert listed == sorted(set(listed))
    new = {code: files for code, files in found.items() if code not in listed}
    assert new == {}, f"add new codes to {LISTED.name}: scripts rely on those that exist"
    gone = set(listed) - set(found)
    assert gone == set(), f"a removed or renamed code moves to {REMOVED.name}, and CHANGELOG.md says why"
    assert removed & set(found) == set(), "a removed code must not come back with another meaning"


def test_the_changelog_names_every_removed_code() -> None:
    changelog = (CHECKOUT / "CHANGELOG.md").read_text()
    assert [code for code in REMOVED.read_text().splitlines() if f"`{code}`" not in changelog] == []


def test_every_code_is_explained_and_every_explained_code_exists() -> None:
    """``keymint explain`` has a text about each; it is written where codes are added."""
    listed = set(LISTED.read_text().splitlines())
    assert listed - set(explanations()) == set(), "write cause, effect and remedy into explanations.toml"
    assert set(explanations()) - listed == set()


def test_every_expanded_f_string_exists() -> None:
    used = {ast.unparse(node) for path in SOURCES for node in ast.walk(ast.parse(path.read_text())) if is_text(node)}
    assert [text for text in F_STRINGS if text not in used] == []


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr | ast.Call)


@pytest.mark.parametrize(
    ("source", "codes"),
    [
        ("raise KeymintError('x', code='file-gone')", {"file-gone"}),
        ("yield Diagnostic.note('key-old', 'is old')", {"key-old"}),
        ("yield Diagnostic('key-old' if x else 'key-new', severity, 'is old')", {"key-old", "key-new"}),
        ("GONE = 'file-gone'\nraise KeymintError('x', code=GONE)", {"file-gone"}),
        ("OLD, NEW = 'is-old', 'is-new'\nyield Diagnostic.note(pins.NEW, 'x')", {"is-new"}),
        ("def _late(self, text: str, code: str): ...\nyield self._late('a-b', 'is-late')", {"is-late"}),
        ("def late(code: str = 'is-late'): ...", {"is-late"}),
        ("for code, text in [('is-late', 'x')]:\n    yield Diagnostic.note(code, text)", {"is-late"}),
        ("yield Diagnostic.error(f'size-{kind}', 'x')", {"size-governance", "size-permissions"}),
    ],
)
def test_the_scan_finds(source: str, codes: set[str]) -> None:
    assert set(codes_in({"module.py": source})) == codes


def test_an_f_string_that_the_table_lacks_is_an_error() -> None:
    with pytest.raises(KeyError, match="late"):
        codes_in({"module.py": "yield Diagnostic.error(f'{what}-late', 'x')"})
