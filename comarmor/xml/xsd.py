"""What an XSD allows in an element, for messages: validators do not always say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from lxml import etree

_XS = "{http://www.w3.org/2001/XMLSchema}"


@dataclass(frozen=True, slots=True, eq=False)
class Vocabulary:
    """The names that an XSD knows.

    Attributes:
        elements: declarations of the elements that may be a root.
        types: complex types by name.
        groups: groups of elements by name.
        attributes: names of all attributes, sorted.
    """

    elements: Mapping[str, etree._Element]
    types: Mapping[str, etree._Element]
    groups: Mapping[str, etree._Element]
    attributes: tuple[str, ...]

    @classmethod
    def of(cls, schema: etree._Element) -> Vocabulary:
        """Return the vocabulary of a schema document."""

        def named(tag: str) -> dict[str, etree._Element]:
            return {item.get("name", ""): item for item in schema.iterchildren(f"{_XS}{tag}")}

        attributes = {str(item.get("name")) for item in schema.iter(f"{_XS}attribute") if item.get("name")}
        return cls(named("element"), named("complexType"), named("group"), tuple(sorted(attributes)))

    def allowed_in(self, element: etree._Element) -> tuple[str, ...]:
        """Return the names of the elements that an element of a document may hold, or none if it is not known."""
        path = [element.tag, *(outer.tag for outer in element.iterancestors())]
        declaration = self.elements.get(str(path.pop()))
        while path and declaration is not None:
            declaration = self._children(declaration).get(str(path.pop()))
        return () if declaration is None else tuple(self._children(declaration))

    def _children(self, declaration: etree._Element) -> dict[str, etree._Element]:
        """Return the declarations of what an element may hold, by name."""
        type_ = self.types.get(declaration.get("type", ""), declaration)
        found: dict[str, etree._Element] = {}
        for child in self._declared(type_):
            name = str(child.get("name") or child.get("ref", ""))
            found.setdefault(name, self.elements.get(name, child) if child.get("ref") else child)
        return found

    def _declared(self, holder: etree._Element) -> Iterator[etree._Element]:
        """Yield the declarations in a type or group, not those in the elements that it declares."""
        for child in holder:
            if child.tag == f"{_XS}element":
                yield child
            elif child.tag == f"{_XS}group" and child.get("ref") in self.groups:
                yield from self._declared(self.groups[child.get("ref", "")])
            else:
                if child.tag == f"{_XS}extension" and child.get("base") in self.types:
                    yield from self._declared(self.types[child.get("base", "")])
                yield from self._declared(child)
