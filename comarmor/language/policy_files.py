# SPDX-License-Identifier: Apache-2.0
"""The files of a policy, the documents that their includes stand for, and what is accepted as an include."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from lxml import etree

from comarmor.errors import ComArmorError, Origin
from comarmor.text import did_you_mean, quote
from comarmor.values import Data, field
from comarmor.xml.package_folders import ShippedFile
from comarmor.xml.reader import line, place


class IncludeFormat(Data):
    """What a language accepts as an include.

    Attributes:
        tags: its elements.
        href_of: checks such an element at a place, and returns its ``href``.
        advice: what to do about a missing file.
    """

    tags: tuple[str, ...]
    href_of: Callable[[etree._Element, Origin], str]
    advice: str = ""


def href_of(element: etree._Element, where: Origin, known: tuple[str, ...] = ("href", "parse")) -> str:
    """Return the ``href`` of an ``xi:include`` element that includes an XML file.

    Args:
        element: the element.
        where: its place.
        known: the attributes of the format; without ``xpointer`` the file is included as a whole.

    Raises:
        ComArmorError: it has another attribute, includes text, or has a fallback.
    """
    for attribute in map(str, element.attrib):
        if attribute not in known:
            expected = f"{', '.join(known[:-1])} and {known[-1]}"
            message = f"xi:include has the attribute {quote(attribute)}, expected only {expected}"
            raise ComArmorError(message, where=where, help=did_you_mean(attribute, known), code="schema")
    if element.get("parse", "xml") != "xml":
        message, help_ = 'xi:include can only have parse="xml"', 'write parse="xml", or leave it out'
        raise ComArmorError(message, where=where, help=help_, code="include-parse")
    if len(element):
        raise ComArmorError(
            "xi:include must be empty; xi:fallback is not supported",
            where=Origin(where.file, line(element[0]), where.chain),
            help="a missing include is an error, so that no rule is ever left out silently",
            code="include-fallback",
        )
    return element.get("href", "")


class ProfileCopy(Data):
    """A profile that is taken out.

    Attributes:
        first: the line where the first profile of its form begins.
        line: the line where it begins itself.
        name: its name.
        texts: what it has as texts of attachments, by their lines in the first profile.
    """

    first: int
    line: int
    name: str
    texts: Mapping[int, str]


class ShortDocument(Data):
    """A document without the profiles that are like others.

    Attributes:
        content: the rest, in the same lines and columns.
        copies: what was taken out, in order.
        kept: line and column where profiles must be that are left, so that the copies are profiles.
    """

    content: bytes
    copies: tuple[ProfileCopy, ...] = ()
    kept: frozenset[tuple[int, int]] = frozenset()


class PolicyFile(Data, eq=False):
    """One file of a policy.

    Attributes:
        name: path as the user would type it.
        content: its bytes.
        root: the root element, with its ``xi:include`` elements.
        includes: the included document of each ``xi:include`` element.
        nodes: number of elements, with those of included documents counted at each inclusion that reads or copies them.
        inclusions: number of such inclusions, nested ones included.
        uniform: it has rules only, and uses no tunables, so that it means the same wherever it is included. A document
            with anything else includes it without reading or copying it.
        package: name of the package that ships it; empty for a file of the policy's owner.
        climbs: number of folders above its own that the paths of its includes, nested ones included, lead through.
        short: what the root was parsed from.
    """

    name: str
    content: bytes = field(repr=False)
    root: etree._Element
    includes: Mapping[etree._Element, PolicyFile]
    nodes: int
    inclusions: int
    uniform: bool
    package: str = ""
    climbs: int = 0
    short: ShortDocument = ShortDocument(b"")

    def place(self, element: etree._Element, chain: tuple[Origin, ...] = ()) -> Origin:
        """Return the place of an element of it, with the places that include the file, innermost first."""
        number, column = place(element)
        return Origin(self.name, number, chain, column)


class PolicyFiles(Data):
    """The files of a policy.

    Attributes:
        roots: its root documents, in order.
        seen: the :func:`comarmor.language.source.fingerprint` of every path that was looked at, whether it exists or
            not.
        shipped: those of its files that packages ship, each once.
    """

    roots: tuple[PolicyFile, ...]
    seen: Mapping[Path, bytes]
    shipped: tuple[ShippedFile, ...] = ()

    def documents(self) -> Iterator[tuple[PolicyFile, tuple[Origin, ...]]]:
        """Yield each document once, with the places that include it where it is first included, innermost first."""
        met: set[PolicyFile] = set()
        for root in self.roots:
            if root not in met:
                yield from _documents(root, (), met)


def _documents(
    document: PolicyFile, chain: tuple[Origin, ...], met: set[PolicyFile]
) -> Iterator[tuple[PolicyFile, tuple[Origin, ...]]]:
    """Yield a document and those that it includes; see :meth:`PolicyFiles.documents`.

    It is no function inside of another one, which would keep all documents until cycles are searched.
    """
    met.add(document)
    yield document, chain
    for element, included in document.includes.items():
        if included not in met:
            yield from _documents(included, (document.place(element), *chain), met)
