# SPDX-License-Identifier: Apache-2.0
"""Pages of the reference that are made from the code: verbs from click, codes, and files of a workspace from schemas.

Sphinx calls :func:`setup`, which writes them to ``docs/reference/generated/``, of which git keeps nothing.
"""

from __future__ import annotations

import copy
import inspect
import itertools
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from lxml import etree
from sphinx.application import Sphinx

from keymint.cli import GROUPS, cli
from keymint.commands.tool.explain import PARTS
from keymint.output.explanations import explanations

CHECKOUT = Path(__file__).resolve().parents[1]
FOLDER = CHECKOUT / "docs" / "reference" / "generated"
SCHEMAS = CHECKOUT / "schemas"
XS = "{http://www.w3.org/2001/XMLSchema}"

EXAMPLE = FOLDER / "example"
"""The policy of the examples and its workspace, which has each kind of file; ``.ci/docs`` makes it."""
NAMES = {"NAME": "robot1/camera", "AUTHORITY": "identity_ca", "PACKAGE": "demo_sensors"}
"""What stands for the names in the paths of :func:`folders` in that workspace."""
ASPECTS = {"writer": "Written by", "edit": "May be edited", "secret": "Secret", "delete": "May be deleted"}
_JUDGED = ("edit", "secret", "delete")
File = Mapping[str, str]
"""What ``docs/reference/files.toml`` says of a file."""


def setup(app: Sphinx) -> Mapping[str, bool]:
    """Have Sphinx write the pages before it reads any."""
    app.connect("builder-inited", lambda _: write())
    return {"parallel_read_safe": True}


def write() -> None:
    """Write all pages, with an index of each kind."""
    files = {page_of(each): file_page(each) for each in documents()}
    pages = {name.replace(" ", "-"): verb_page(name, command) for name, command in verbs()}
    for folder_name, index, texts in (("verbs", verbs_page(), pages), ("files", files_page(), files)):
        (FOLDER / folder_name).mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (FOLDER / folder_name / f"{name}.md").write_text(text)
        contents = "```{toctree}\n:hidden:\n\n" + "\n".join(texts) + "\n```\n"
        (FOLDER / folder_name / "index.md").write_text(f"{index}\n{contents}")
    (FOLDER / "codes.md").write_text(codes_page())


# -- codes -------------------------------------------------------------------------------------------------------------


def codes_page() -> str:
    """Return the page of the codes of errors and findings, with the texts of ``keymint explain``, after an index.

    All codes are on one page, so that the address of a code needs no more than the code.
    """
    known = explanations()
    groups = Counter(name.partition("-")[0] for name in known)
    index: dict[str, list[str]] = {}
    for name in known:
        first = name.partition("-")[0]
        index.setdefault(first if groups[first] >= _GROUP else _OTHERS, []).append(f"[{name}](#{name})")
    lines = ["# Codes", "", "Each message ends with its code; `keymint explain CODE` prints the same.", ""]
    for group, links in sorted(index.items(), key=lambda each: (each[0] == _OTHERS, each)):
        lines += [f"* **{group}**: {', '.join(links)}"]
    for name, texts in known.items():
        lines += ["", f"## {name}", ""]
        lines += [f"* **{part}**: {escaped(' '.join(texts[part].split()))}" for part in PARTS]
    return "\n".join([*lines, ""])


_GROUP, _OTHERS = 5, "others"
"""The fewest codes with one first word that the index of codes lists by themselves, and the name of all others."""


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


def verbs_page() -> str:
    """Return the index of the verbs: what each is for, in the groups of ``keymint --help``."""
    lines = ["# Verbs", "", "`keymint VERB --help` prints the page of a verb.", ""]
    for title, group in GROUPS.items():
        lines += [f"## {title}", ""]
        for name, command in verbs():
            if name.partition(" ")[0] in group:
                purpose = group.get(name) or (command.help or "").partition("\n")[0]
                lines.append(f"* [keymint {name}]({name.replace(' ', '-')}.md): {escaped(purpose)}")
        lines.append("")
    return "\n".join(lines)


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
    text = [*paragraphs(command.help or "")]
    if isinstance(command, click.Group):
        text += [f"* [keymint {name} {below}]({name}-{below}.md)" for below in command.list_commands(context)]
    return "\n".join([f"# keymint {name}", "", "```", usage, "```", "", *text, "", "## Options", "", *usual, "", *few])


def option_table(parameters: Iterable[click.Parameter], context: click.Context) -> list[str]:
    """Return the lines of a table of options with their meaning; arguments have none."""
    options = (each for each in parameters if isinstance(each, click.Option))
    rows = [row for each in options if (row := each.get_help_record(context))]
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


def folders() -> Sequence[Mapping[str, Any]]:
    """Return what is known of every file of a workspace or a keystore, by folder."""
    found: Sequence[Mapping[str, Any]] = tomllib.loads((FOLDER.parent / "files.toml").read_text())["folder"]
    return found


def documents() -> Iterator[File]:
    """Yield the files that have a schema, and so a page."""
    return (each for folder in folders() for each in folder["file"] if "schema" in each)


def page_of(file: File) -> str:
    """Return the name of the page of a file."""
    return file["path"].removeprefix("profile/").replace("/", "-")


def files_page() -> str:
    """Return the page with every file of a workspace: what it is for, who writes it, and what you may do with it."""
    lines = ["# Files of a workspace", "", "Also those of a keystore and of the keystore of a robot.", ""]
    titles = " | ".join(("File", "What it is, and who writes it", *(ASPECTS[each] for each in _JUDGED)))
    for folder in folders():
        lines += [f"## {folder['title']}", "", folder["text"], "", f"| {titles} |", "|---" * 5 + "|"]
        for each in folder["file"]:
            shown = code(each["path"].removeprefix(folder.get("prefix", "")))
            name = f"[{shown}]({page_of(each)}.md)" if "schema" in each else shown
            judged = " | ".join(each[aspect] for aspect in _JUDGED)
            lines.append(f"| {name} | {each['about']} Written by {each['writer']}. | {judged} |")
        lines.append("")
    return "\n".join(lines)


def file_page(file: File) -> str:
    """Return the page of a file: what it is for, who writes it, an example, and the meaning of each element.

    Args:
        file: what is known of it.
    """
    path = SCHEMAS / f"{file['schema']}.xsd"
    example = example_of(file)
    defaults = values(EXAMPLE / "robot_ws" / file["defaults"]) if "defaults" in file else {}
    facts_of_file = "\n".join(f"* **{title}**: {file[each]}." for each, title in ASPECTS.items())
    lines = [f"# {file['path']}", "", file["about"], "", facts_of_file, ""]
    lines += ["## Example", "", "```xml", example, "```", "", "## Elements", ""]
    for each, occurs, value, meaning in Schema(path).rows():
        depth, name = each.count("/"), each.rpartition("/")[2]
        usual = next((text for end, text in defaults.items() if each.endswith(f"/{end}")), None)
        facts = ", ".join(filter(None, (occurs, "" if value == "elements" else value)))
        default = "" if usual is None else f" Default: {code(usual) if usual else 'empty'}."
        lines.append(f"{'  ' * depth}* {code(name)}: {facts}. {escaped(meaning)}{default}")
    if defaults:
        lines += ["", f"Defaults are those of `{file['defaults']}` in a new workspace."]
    link = f"../../../../{path.relative_to(CHECKOUT)}"
    return "\n".join([*lines, "", f"The schema that Keymint checks it with: [`{file['schema']}.xsd`]({link}).", ""])


def example_of(file: File) -> str:
    """Return the example of a file, with the first line alone of what is encoded in a certificate."""
    path = file["path"]
    for name, value in NAMES.items():
        path = path.replace(name, value)
    text = (EXAMPLE / file.get("example", f"robot_ws/{path}")).read_text().replace(f"{EXAMPLE}/", "/home/me/")
    return re.sub(r"(?<=-----\n)(.{64}\n)[^-]*", r"\1…\n", text).rstrip()


def values(path: Path) -> Mapping[str, str]:
    """Return the text of each element without children by its path below the root; dates are those of the example."""
    tree = etree.parse(path)
    leaves = (each for each in tree.iter(etree.Element) if not len(each))
    found = {tree.getelementpath(each): (each.text or "").strip() for each in leaves}
    return {place: text for place, text in found.items() if not place.startswith("validity")}


class Schema:
    """An XML schema with those that it includes.

    Args:
        path: its file.
    """

    def __init__(self, path: Path) -> None:
        root = etree.parse(path).getroot()
        self.roots = [root, *(etree.parse(each).getroot() for each in _included(path, set()))]
        self.types = {each.get("name"): each for top in self.roots for each in top if each.tag in _TYPES}
        self.elements = {each.get("name"): each for top in self.roots for each in top if each.tag == f"{XS}element"}
        self.texts: dict[tuple[str, str], str] = {}
        for each in itertools.chain.from_iterable(top.iter(f"{XS}element", f"{XS}attribute") for top in self.roots):
            if text := _documentation(each):
                self.texts.setdefault((each.tag, each.get("name")), text)

    def rows(self) -> Iterator[tuple[str, str, str, str]]:
        """Yield the path of each element and attribute once, how often it occurs, its values, and its meaning.

        An element or attribute without a text means what the first one of its name does, or else its type.
        """
        found: dict[str, tuple[str, str, str, str]] = {}
        for element in self.elements.values():
            for row in self._element(element, "", ()) if element.getparent() is self.roots[0] else ():
                if row[0] not in found or row[1] == "optional":  # it may be left out in one order of a choice
                    found[row[0]] = row
        yield from found.values()

    def _element(self, element: Any, above: str, seen: tuple[str, ...]) -> Iterator[tuple[str, str, str, str]]:
        name = element.get("name") or element.get("ref")
        path = f"{above}/{name}" if above else name
        declared = self.elements[name.removeprefix("xi:")] if element.get("ref") else element
        kind = declared.get("type", "")
        definition = self.types.get(kind, declared)
        yield path, _occurs(element), self._value(kind, definition), self._meaning(declared, kind)
        if kind not in seen and (declared is element or name.startswith("xi:")):
            yield from self._content(definition, path, (*seen, kind) if kind else seen)

    def _meaning(self, declared: Any, kind: str) -> str:
        own = _documentation(declared) or self.texts.get((declared.tag, declared.get("name")), "")
        return own or (_documentation(self.types[kind]) if kind in self.types else "")

    def _content(self, parent: Any, path: str, seen: tuple[str, ...]) -> Iterator[tuple[str, str, str, str]]:
        for child in parent:
            if child.tag == f"{XS}attribute":
                required = "once" if child.get("use") == "required" else "optional"
                kind = child.get("type", "")
                value = self._value(kind, self.types.get(kind, child))
                yield f"{path}/@{child.get('name')}", required, value, self._meaning(child, kind)
            elif child.tag == f"{XS}element":
                yield from self._element(child, path, seen)
            elif isinstance(child.tag, str) and child.tag not in {f"{XS}simpleType", f"{XS}annotation"}:
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


_TYPES = {f"{XS}{kind}" for kind in ("complexType", "simpleType", "group", "attributeGroup")}


def _included(path: Path, seen: set[Path]) -> Iterator[Path]:
    for each in etree.parse(path).getroot().iter(f"{XS}include", f"{XS}import"):
        found = (path.parent / str(each.get("schemaLocation"))).resolve()
        if found not in seen:
            seen.add(found)
            yield found
            yield from _included(found, seen)


def _documentation(element: Any) -> str:
    return " ".join((element.findtext(f"{XS}annotation/{XS}documentation") or "").split())


def _occurs(element: Any) -> str:
    least, most = element.get("minOccurs", "1"), element.get("maxOccurs", "1")
    above = element.getparent()
    if above.tag == f"{XS}choice":
        least = "0"
        most = "unbounded" if above.get("maxOccurs") == "unbounded" else most
    words = {("1", "1"): "once", ("0", "1"): "optional", ("1", "unbounded"): "once or more"}
    return words.get((least, most), "any number")
