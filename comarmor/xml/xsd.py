# SPDX-License-Identifier: Apache-2.0
"""The elements that an XSD allows inside an element, for messages: libxml2 does not always report them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from lxml import etree

from comarmor.values import dataclass

XS = "{http://www.w3.org/2001/XMLSchema}"


@dataclass(frozen=True, slots=True, eq=False)
class SchemaVocabulary:
    """The names that an XSD declares, with those of the XSDs that it includes.

    Attributes:
        elements: declarations of the elements that may be a root.
        types: complex types by name.
        groups: groups of elements by name.
        names: names of all elements, sorted.
        attributes: names of all attributes, sorted.
    """

    elements: Mapping[str, etree._Element]
    types: Mapping[str, etree._Element]
    groups: Mapping[str, etree._Element]
    names: tuple[str, ...]
    attributes: tuple[str, ...]

    @classmethod
    def of(cls, documents: Iterable[etree._Element]) -> SchemaVocabulary:
        """Return the vocabulary of an XSD.

        Args:
            documents: root elements of the XSD and of those that it includes.
        """
        schemas = tuple(documents)

        def top_level(tag: str) -> dict[str, etree._Element]:
            return {item.get("name", ""): item for schema in schemas for item in schema.iterchildren(f"{XS}{tag}")}

        def names(tag: str) -> tuple[str, ...]:
            declared = (item.get("name") for schema in schemas for item in schema.iter(f"{XS}{tag}"))
            return tuple(sorted({str(name) for name in declared if name}))

        types, groups = top_level("complexType"), top_level("group")
        return cls(top_level("element"), types, groups, names("element"), names("attribute"))

    def allowed_in(self, element: etree._Element) -> tuple[str, ...]:
        """Return the names of the elements that are allowed in an element of a document; none if it is not declared."""
        path = [element.tag, *(outer.tag for outer in element.iterancestors())]
        declaration = self.elements.get(str(path.pop()))
        while path and declaration is not None:
            declaration = self._children(declaration).get(str(path.pop()))
        return () if declaration is None else tuple(self._children(declaration))

    def _children(self, declaration: etree._Element) -> dict[str, etree._Element]:
        """Return the declarations of the elements allowed in a declared element, by name."""
        type_ = self.types.get(declaration.get("type", ""), declaration)
        children: dict[str, etree._Element] = {}
        for child in self._declared(type_):
            name = str(child.get("name") or child.get("ref", ""))
            children.setdefault(name, self.elements.get(name, child) if child.get("ref") else child)
        return children

    def _declared(self, holder: etree._Element) -> Iterator[etree._Element]:
        """Yield the element declarations directly in a type or group."""
        for child in holder:
            if child.tag == f"{XS}element":
                yield child
            elif child.tag == f"{XS}group" and child.get("ref") in self.groups:
                yield from self._declared(self.groups[child.get("ref", "")])
            else:
                if child.tag == f"{XS}extension" and child.get("base") in self.types:
                    yield from self._declared(self.types[child.get("base", "")])
                yield from self._declared(child)
