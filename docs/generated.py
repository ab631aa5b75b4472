# SPDX-License-Identifier: Apache-2.0
"""Pages of the reference that are made from the code: verbs from click, codes, and files of a workspace from schemas.

Sphinx calls :func:`setup`, which writes them to ``docs/reference/generated/``, of which git keeps nothing.
"""

from __future__ import annotations

import copy
import inspect
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click
from lxml import etree
from sphinx.application import Sphinx

from keymint.cli import cli
from keymint.commands.tool.explain import PARTS
from keymint.output.explanations import explanations

CHECKOUT = Path(__file__).resolve().parents[1]
FOLDER = CHECKOUT / "docs" / "reference" / "generated"
SCHEMAS = CHECKOUT / "schemas"
XS = "{http://www.w3.org/2001/XMLSchema}"

PROFILE, PACKAGE, DEFAULTS = "profile/", "src/NAME/", "profile/package.defaults/"
FILES: Mapping[str, str] = {
    PROFILE + "keymint_profile.xml": "keymint_ros/keymint_profile",
    PROFILE + "policies.xml": "keymint_ros/policies",
    PROFILE + "authorities.xml": "keymint_ros/authorities",
    PROFILE + "profile.defaults/authorities.xml": "keymint_ros/defaults_authorities",
    PROFILE + "authority_issuance.xml": "keymint_ros/authority_issuance",
    PROFILE + "packages.lock.xml": "keymint_ros/packages_lock",
    DEFAULTS + "identities.xml": "keymint_ros/defaults_identities",
    DEFAULTS + "permissions.xml": "keymint_ros/defaults_permissions",
    DEFAULTS + "governance.xml": "keymint_ros2_dds/source_governance_defaults",
    DEFAULTS + "zenoh.xml": "keymint_ros2_zenoh/source_zenoh",
    PACKAGE + "keymint_package.xml": "keymint_ros/keymint_package",
    PACKAGE + "identities.xml": "keymint_ros/identities",
    PACKAGE + "permissions.xml": "keymint_ros/permissions",
    PACKAGE + "governance.xml": "keymint_ros2_dds/source_governance",
    PACKAGE + "zenoh.xml": "keymint_ros2_zenoh/source_zenoh",
    PACKAGE + "issuance.xml": "keymint_ros/issuance",
}
"""The schema of each XML file of a workspace, by where the file lies."""


def setup(app: Sphinx) -> Mapping[str, bool]:
    """Have Sphinx write the pages before it reads any."""
    app.connect("builder-inited", lambda _: write())
    return {"parallel_read_safe": True}


def write() -> None:
    """Write all pages, with an index of each kind."""
    kinds = (
        ("verbs", "Verbs", {name.replace(" ", "-"): verb_page(name, command) for name, command in verbs()}),
        ("files", "Files of a workspace", {page_of(place): file_page(place) for place in FILES}),
    )
    for folder, title, pages in kinds:
        (FOLDER / folder).mkdir(parents=True, exist_ok=True)
        for name, text in pages.items():
            (FOLDER / folder / f"{name}.md").write_text(text)
        listed = "\n".join(pages)
        index = f"# {title}\n\n```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```\n"
        (FOLDER / folder / "index.md").write_text(index)
    (FOLDER / "codes.md").write_text(codes_page())


# -- codes -------------------------------------------------------------------------------------------------------------


def codes_page() -> str:
    """Return the page of the codes of errors and findings, with the texts of ``keymint explain``."""
    lines = ["# Codes", "", "Each message ends with its code; `keymint explain CODE` prints the same.", ""]
    for name, texts in explanations().items():
        lines += [f"## {name}", ""]
        lines += [f"* **{part}**: {escaped(' '.join(texts[part].split()))}" for part in PARTS]
        lines.append("")
    return "\n".join(lines)


# -- verbs -------------------------------------------------------------------------------------------------------------


def verbs() -> Iterator[tuple[str, click.Command]]:
    """Yield each verb with its name, also those of groups, as ``authority renew``."""
    context = click.Context(cli)
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        yield name, command
        if isinstance(command, click.Group):
            for below in command.list_commands(context):
                found = command.get_command(context, below)
                assert found is not None
                yield f"{name} {below}", found


def verb_page(name: str, command: click.Command) -> str:
    """Return the page of a verb: how it is called, what it does, its options."""
    context = click.Context(command, info_name=f"keymint {name}")
    usage = " ".join(["keymint", name, *command.collect_usage_pieces(context)])
    usual = option_table(command.get_params(context), context)
    hidden = [
        copy.copy(each) for each in command.params if isinstance(each, click.Option) and each.hidden and each.help
    ]
    for each in hidden:
        each.hidden = False
    few = ["## Options that few users need", "", *option_table(hidden, context), ""] if hidden else []
    text = paragraphs(command.help or "")
    return "\n".join([f"# keymint {name}", "", "```", usage, "```", "", *text, "", "## Options", "", *usual, "", *few])


def option_table(parameters: Iterable[click.Parameter], context: click.Context) -> list[str]:
    """Return the lines of a table of options with their meaning; arguments have none."""
    rows = [row for each in parameters if (row := each.get_help_record(context))]
    return ["| option | meaning |", "|---|---|", *(f"| {code(form)} | {cell(meaning)} |" for form, meaning in rows)]


def paragraphs(text: str) -> Iterator[str]:
    """Yield the lines of a help text as Markdown; click's mark of a paragraph that keeps its lines makes a block."""
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        lines = paragraph.splitlines()
        if lines and lines[0].strip() == "\b":
            yield from ("```", *lines[1:], "```", "")
        else:
            yield from (*(escaped(line) for line in lines), "")


def code(text: str) -> str:
    """Return a text as code in a cell of a table."""
    return "`" + text.replace("|", "\\|") + "`"


def cell(text: str) -> str:
    """Return a text for a cell of a table."""
    return escaped(" ".join(text.split())).replace("|", "\\|")


def escaped(text: str) -> str:
    """Return a text whose characters mean nothing to Markdown."""
    for character in "\\`*_<[{$":
        text = text.replace(character, f"\\{character}")
    return text


# -- files of a workspace ----------------------------------------------------------------------------------------------


def page_of(place: str) -> str:
    """Return the name of the page of a file."""
    return place.removeprefix(PROFILE).replace("/", "-")


def file_page(place: str) -> str:
    """Return the page of a file: what it is for, and each element with its type and meaning.

    Args:
        place: where the file lies in a workspace.
    """
    path = SCHEMAS / f"{FILES[place]}.xsd"
    document = Schema(path)
    about = document.about.partition(":")[2].strip() or document.about
    lines = [f"# {place}", "", escaped(about[:1].upper() + about[1:]), ""]
    for each, occurs, value, meaning in document.rows():
        depth, name = each.count("/"), each.rpartition("/")[2]
        facts = ", ".join(filter(None, (occurs, "" if value == "elements" else value)))
        lines.append(f"{'  ' * depth}* {code(name)}: {facts}{f'. {escaped(meaning)}' if meaning else ''}")
    link = f"../../../../{path.relative_to(CHECKOUT)}"
    return "\n".join([*lines, "", f"The schema that Keymint checks it with: [`{FILES[place]}.xsd`]({link}).", ""])


class Schema:
    """An XML schema with those that it includes.

    Args:
        path: its file.
    """

    def __init__(self, path: Path) -> None:
        root = etree.parse(path).getroot()
        before = [root] if root.getprevious() is None else [*root.itersiblings(tag=etree.Comment, preceding=True)]
        self.about = " ".join(str(before[0].text).split()) if before and before[0] is not root else ""
        self.roots = [root, *(etree.parse(each).getroot() for each in _included(path, set()))]
        self.types = {each.get("name"): each for top in self.roots for each in top if each.tag in _TYPES}
        self.elements = {each.get("name"): each for each in root if each.tag == f"{XS}element"}

    def rows(self) -> Iterator[tuple[str, str, str, str]]:
        """Yield the path of each element and attribute, how often it occurs, its values, and its meaning."""
        for element in self.elements.values():
            yield from self._element(element, "", ())

    def _element(self, element: Any, above: str, seen: tuple[str, ...]) -> Iterator[tuple[str, str, str, str]]:
        name = element.get("name") or element.get("ref")
        path = f"{above}/{name}" if above else name
        kind = element.get("type", "")
        definition = self.types.get(kind, element)
        meaning = _comment(element) or ("" if kind in {"", "Text"} else _comment(definition))
        yield path, _occurs(element), self._value(kind, definition), meaning
        if kind in seen or element.get("ref"):
            return
        yield from self._content(definition, path, (*seen, kind) if kind else seen)

    def _content(self, parent: Any, path: str, seen: tuple[str, ...]) -> Iterator[tuple[str, str, str, str]]:
        for child in parent:
            if child.tag == f"{XS}attribute":
                required = "once" if child.get("use") == "required" else "optional"
                kind = child.get("type", "")
                value = self._value(kind, self.types.get(kind, child))
                yield f"{path}/@{child.get('name')}", required, value, _comment(child)
            elif child.tag == f"{XS}element":
                yield from self._element(child, path, seen)
            elif isinstance(child.tag, str) and child.tag != f"{XS}simpleType":
                base = self.types.get(child.get("base") or child.get("ref"))
                if base is not None:
                    yield from self._content(base, path, seen)
                yield from self._content(child, path, seen)

    def _value(self, kind: str, definition: Any) -> str:
        """Return what may stand in an element or attribute of a type, for people."""
        if kind.startswith("xs:"):
            return code(kind.removeprefix("xs:"))
        if any(each is not definition for each in definition.iter(f"{XS}element", f"{XS}any")):
            return "elements"
        facets = [(each.tag.removeprefix(XS), each.get("value")) for each in definition.iter() if each.get("value")]
        values = [code(value) for name, value in facets if name in {"enumeration", "pattern"}]
        ends = [value for name, value in facets if name in {"minInclusive", "maxInclusive"}]
        derived = next(definition.iter(f"{XS}restriction", f"{XS}extension"), None)
        if values:
            text = ", ".join(values)
        elif ends:
            text = " to ".join(ends if len(ends) > 1 else ["0", *ends])
        elif derived is None:
            text = "empty"
        else:
            base = derived.get("base")
            text = self._value(base, self.types[base]) if base in self.types else "text"
        return text


_TYPES = {f"{XS}complexType", f"{XS}simpleType", f"{XS}group"}


def _included(path: Path, seen: set[Path]) -> Iterator[Path]:
    for each in etree.parse(path).getroot().iter(f"{XS}include"):
        found = (path.parent / str(each.get("schemaLocation"))).resolve()
        if found not in seen:
            seen.add(found)
            yield found
            yield from _included(found, seen)


def _comment(element: Any) -> str:
    """Return the comment before a declaration, or its annotation."""
    documentation = element.find(f"{XS}annotation/{XS}documentation")
    if documentation is not None:
        return " ".join("".join(documentation.itertext()).split())
    before = element.getprevious()
    return " ".join(str(before.text).split()) if before is not None and before.tag is etree.Comment else ""


def _occurs(element: Any) -> str:
    least, most = element.get("minOccurs", "1"), element.get("maxOccurs", "1")
    above = element.getparent()
    if above.tag == f"{XS}choice":
        least = "0"
        most = "unbounded" if above.get("maxOccurs") == "unbounded" else most
    words = {("1", "1"): "once", ("0", "1"): "optional", ("1", "unbounded"): "once or more"}
    return words.get((least, most), "any number")
