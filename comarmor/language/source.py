# SPDX-License-Identifier: Apache-2.0
"""Read the files of a policy and resolve their includes, which are confined to the policy's folder.

``xi:include`` (XInclude 1.0, W3C 2006) is resolved here and not by a library for three reasons: the origin of every
element must be known; no file outside the policy may be reached, not even through a symbolic link; and the size must
be known before includes are expanded. Each file is read once, however often it is included.
"""

from __future__ import annotations

import hashlib
import posixpath
from collections.abc import Callable, Sequence
from pathlib import Path
from types import MappingProxyType

from lxml import etree

from comarmor.errors import ComArmorError, Origin
from comarmor.language.policy_files import IncludeFormat, PolicyFile, PolicyFiles, ShortDocument, href_of
from comarmor.rules import PERMISSIONS
from comarmor.text import quote
from comarmor.values import Data, field, replace
from comarmor.xml.package_folders import PackageFolders, ShippedFile
from comarmor.xml.reader import LIMITS, XINCLUDE, Limits, parse, place
from comarmor.xml.sandboxed_paths import SandboxedFolder, checked_path, file_errors, package_path, path_of, path_text

INCLUDE = f"{{{XINCLUDE}}}include"
TESTS = ".test.xml"
"""Suffix of policy tests, which are beside the policy's root files."""
_COMARMOR = IncludeFormat((INCLUDE,), href_of)


def load_tree(
    path: Path,
    library: Path | None = None,
    library_shown: Path | None = None,
    *,
    packages: PackageFolders | None = None,
    limits: Limits = LIMITS,
    form: IncludeFormat = _COMARMOR,
    shorten: Callable[[bytes], ShortDocument] = ShortDocument,
) -> PolicyFiles:
    """Read a policy: a file, or the ``*.xml`` files directly in a directory, in sorted order.

    Args:
        path: file or directory; includes are confined to the directory, or the file's own folder.
        library: a folder that is searched for included files which the policy does not have.
        library_shown: path of the library in origins, if it differs from where the library is read.
        packages: where packages are that ship files; without it the policy may include none of theirs.
        limits: limits of files and includes.
        form: the form of includes.
        shorten: returns what a root file is parsed from.

    Raises:
        ComArmorError: something is missing, outside, too large or not well-formed, with ``file:line``.
    """
    shown = path_text(str(path))
    with file_errors("the policy", Origin(shown), "policy-missing"):
        real = path.resolve(strict=True)
        if path.is_dir():
            folder = SandboxedFolder(real, str(path))
            roots = _roots(path)
        else:
            folder = SandboxedFolder(real.parent, str(real.parent if path.is_symlink() else path.parent))
            roots = [real.name]
    if not roots:
        message = "the policy directory has no *.xml file"
        help_ = "put the policy's root files directly into it; files in sub-folders are only reached by includes"
        raise ComArmorError(message, where=Origin(shown), help=help_, code="policy-empty")
    fallback = (
        SandboxedFolder(library.resolve(), str(library_shown or library)) if library and library.is_dir() else None
    )
    reader = _PolicyReader(folder, fallback, limits, packages, form, shorten)
    if path.is_dir():
        reader.seen[Path(folder.shown)] = _names_fingerprint(roots)
    documents: list[PolicyFile] = []
    nodes = inclusions = 0
    for name in roots:
        where = Origin(folder.name(name))
        document = reader.document(folder, name, folder.resolve(name, where), where, ())
        documents.append(document)
        nodes += document.nodes
        inclusions += document.inclusions
        reader.bound(nodes, inclusions, where)
    return reader.result(tuple(documents))


def read_document(
    content: bytes, name: str, library: Path, library_shown: Path | None = None, *, limits: Limits = LIMITS
) -> PolicyFiles:
    """Read a policy that is not a file yet, whose includes are files of the library.

    Args:
        content: the document.
        name: path of the file that it will be, as the user would type it.
        library: the folder of the included files.
        library_shown: path of the library in origins, if it differs from where the library is read.
        limits: limits of files and includes.

    Raises:
        ComArmorError: as of :func:`load_tree`.
    """
    folder = SandboxedFolder(library.resolve(), str(library_shown or library))
    reader = _PolicyReader(folder, folder, limits)
    # The document itself lies nowhere, but its includes are relative to the library's folder.
    document = replace(reader.complete(content, parse(content, name, limits=limits), folder, "-", ()), name=name)
    reader.bound(document.nodes, document.inclusions, Origin(name))
    return reader.result((document,))


def fingerprint(path: Path) -> bytes:
    """Return a digest that changes when a policy read from this path may have changed.

    It is the SHA-256 of a file's bytes, or of the names of a directory's root files; empty for a path that does not
    exist or cannot be read.
    """
    try:
        if path.is_dir():
            return _names_fingerprint(_roots(path))
        return hashlib.sha256(path.read_bytes()).digest()
    except OSError:
        return b""


def _roots(folder: Path) -> list[str]:
    """Return the sorted names of a directory's root files, without its tests."""
    return sorted(
        name
        for name in (entry.name for entry in folder.iterdir())
        if name.endswith(".xml")
        and not name.endswith(TESTS)
        and not name.startswith(".")
        and not (folder / name).is_dir()
    )


def _names_fingerprint(names: Sequence[str]) -> bytes:
    return hashlib.sha256("/".join(names).encode(errors="surrogateescape")).digest()


class _PolicyReader(Data, frozen=False):
    """Reads each file of a policy once.

    Attributes:
        folder: the policy's folder.
        library: the library's folder.
        limits: limits.
        packages: where packages are that ship files.
        form: the form of includes.
        shorten: see :func:`load_tree`.
        files: digests of the files.
        seen: fingerprints of the paths that were looked at.
        shipped: files of packages by package and path.
        done: complete documents, with the paths by which they were read: those of packages by package and path, others
            by resolved path and folder of the name.
        included: documents by folder, the folder in it, and ``href`` of an include there, with the folders above it
            that lead to the document and its includes.
        open: resolved paths of the files that are being read, outermost first.
        total: bytes read.
        renamed: names of packages' files that were read by another name before.
    """

    folder: SandboxedFolder
    library: SandboxedFolder | None
    limits: Limits
    packages: PackageFolders | None = None
    form: IncludeFormat = _COMARMOR
    shorten: Callable[[bytes], ShortDocument] = ShortDocument
    files: dict[Path, bytes] = field(default_factory=dict)
    seen: dict[Path, bytes] = field(default_factory=dict)
    shipped: dict[tuple[str, str], ShippedFile] = field(default_factory=dict)
    done: dict[tuple[str, str], tuple[Path, PolicyFile]] = field(default_factory=dict)
    included: dict[tuple[SandboxedFolder, str, str], tuple[PolicyFile, int]] = field(default_factory=dict)
    open: list[Path] = field(default_factory=list)
    total: int = 0
    renamed: int = 0

    def result(self, roots: tuple[PolicyFile, ...]) -> PolicyFiles:
        """Return what was read for some root documents."""
        return PolicyFiles(roots, MappingProxyType(self.seen), tuple(self.shipped.values()))

    def document(
        self, folder: SandboxedFolder, relative: str, real: Path, where: Origin, chain: tuple[Origin, ...]
    ) -> PolicyFile:
        """Read a file and its includes.

        Args:
            folder: the sandbox.
            relative: path of the file in the sandbox.
            real: its resolved path.
            where: place for the error if it cannot be read.
            chain: the places that include it, innermost first.
        """
        if real in self.files:
            self.seen[folder.place(relative)] = self.files[real]
        if real in self.open:
            message = f"{quote(folder.name(relative), 200)} includes itself"
            help_ = "remove one of the includes of the loop"
            raise ComArmorError(message, where=where, help=help_, code="include-loop")
        named = folder.real / relative
        if folder.package:  # a copy of the package has no links, but each name
            key = folder.package, relative
        else:  # what it includes is relative to the folder of its name, also if that is a link
            key = str(real), str(real.parent if named == real else named.parent.resolve())
        if key in self.done:
            first, document = self.done[key]
            if first != named and _above(first, document.climbs) != _above(named, document.climbs):
                raise ComArmorError(
                    f"a link to a folder makes this file also {quote(path_text(str(first)), 200)},"
                    " from where '..' in its includes leads to other files",
                    where=where,
                    help="include it by one of the two names only, or copy the folder in place of the link",
                    code="include-ambiguous",
                )
            return document
        self.renamed += bool(folder.package) and real in self.files
        if self.renamed > self.limits.renamed:
            message = f"by links the packages' files have more than the {self.limits.renamed:,} other names allowed"
            raise _limit(message, where)
        content = self.read(folder, real, where)
        self.seen[folder.place(relative)] = self.files[real]
        if folder.package:
            self.shipped[key] = ShippedFile(folder.package, relative, content, where)
        short = ShortDocument(content) if chain else self.shorten(content)
        root = parse(short.content, folder.name(relative), limits=self.limits, chain=chain)
        self.open.append(real)
        document = self.complete(content, root, folder, relative, chain)
        document = replace(document, short=short, nodes=content.count(b"<") if short.copies else document.nodes)
        self.done[key] = named, document
        self.open.pop()
        return document

    def complete(
        self, content: bytes, root: etree._Element, folder: SandboxedFolder, relative: str, chain: tuple[Origin, ...]
    ) -> PolicyFile:
        """Read the includes of a document; the arguments are those of :meth:`document`, which read it."""
        name = folder.name(relative)
        includes: dict[etree._Element, PolicyFile] = {}
        nodes, inclusions, climbs, uniform = 0, 0, 0, self.form is _COMARMOR and _is_uniform(root)
        for element in root.iter():
            nodes += 1
            if element.tag not in self.form.tags:
                continue
            number, column = place(element)
            where = Origin(name, number, chain, column)
            if len(self.open) > self.limits.include_depth:
                raise _limit(f"includes are nested more than {self.limits.include_depth} deep", where)
            included, above = self.include(element, folder, relative, where)
            includes[element] = included
            climbs = max(climbs, above)
            if uniform or not included.uniform:
                nodes += included.nodes
                inclusions += 1 + included.inclusions
            self.bound(nodes, inclusions, where)
        uniform = uniform and all(included.uniform for included in includes.values())
        return PolicyFile(
            name, content, root, MappingProxyType(includes), nodes, inclusions, uniform, folder.package, climbs
        )

    def include(
        self, element: etree._Element, folder: SandboxedFolder, relative: str, where: Origin
    ) -> tuple[PolicyFile, int]:
        """Read the file that an ``xi:include`` element refers to, and count the folders above that lead there."""
        href = self.form.href_of(element, where)
        key = folder, posixpath.dirname(relative), href
        if key in self.included:  # many profiles include the same few files
            return self.included[key]
        chain = (where.alone(), *where.chain)
        shipped = package_path(href, where)
        if shipped is not None:
            package, target = shipped
            inner, path = self.package(package, where), ""
        else:
            path = posixpath.normpath(path_of(href, where))
            target = posixpath.normpath(posixpath.join(key[1], path))
            inner, target = folder, checked_path(target, where) if folder.package else target
        real = inner.find(target, where)
        if real is None:
            self.seen[inner.place(target)] = b""
            if not inner.package and self.library is not None and (real := self.library.find(path, where)):
                inner, target = self.library, path
        if real is not None:
            document = self.document(inner, target, real, where, chain)
        elif inner.absent_is_empty:
            document = PolicyFile(inner.name(target), b"", etree.Element("profiles"), {}, 1, 0, True, inner.package)
        else:
            raise self.missing(inner, target, href, where)
        *folders, _ = path.split("/")
        above = folders.count("..")
        if inner is folder:
            above += max(0, document.climbs - (len(folders) - above))
        self.included[key] = document, above
        return self.included[key]

    def package(self, name: str, where: Origin) -> SandboxedFolder:
        """Return the folder of the files that a package ships."""
        if self.packages is None:
            message = f"the package {quote(name)} cannot be looked up here, so none of its files can be included"
            raise ComArmorError(message, where=where, code="package-unavailable")
        folder = self.packages.folder(name, where)
        for path in self.packages.looked_at(name):
            self.seen[path] = fingerprint(path)
        return folder

    def missing(self, folder: SandboxedFolder, target: str, href: str, where: Origin) -> ComArmorError:
        """Return the error for a missing included file, with the searched paths and a similar file name."""
        first = path_text(str(folder.place(target))) if folder.package else folder.name(target)
        places, near = [first], folder.similar_file(target, where.file) or self.form.advice
        if self.library is not None and not folder.package:
            from_root = posixpath.normpath(path_of(href, where))
            places.append(self.library.name(from_root))
            near = near or self.library.similar_file(from_root)
        looked = f"looked for {' and '.join(quote(each, 200) for each in dict.fromkeys(places))}"
        message = f"the included file {quote(href, 200)} does not exist"
        return ComArmorError(message, where=where, help=f"{looked}; {near}" if near else looked, code="include-missing")

    def read(self, folder: SandboxedFolder, real: Path, where: Origin) -> bytes:
        """Return the bytes of a file, and record their digest."""
        content = folder.read(real, self.limits.file_bytes + 1, where)
        self.total += len(content)
        if self.total > self.limits.total_bytes:
            raise _limit(f"the policy has more than the {self.limits.total_bytes:,} bytes allowed", where)
        self.files[real] = hashlib.sha256(content).digest()
        return content

    def bound(self, nodes: int, inclusions: int, where: Origin) -> None:
        """Refuse a policy that would be too large with its includes expanded."""
        if nodes > self.limits.nodes or inclusions > self.limits.inclusions:
            most = f"{self.limits.nodes:,} elements or {self.limits.inclusions:,} inclusions"
            raise _limit(f"with its includes the policy has more than the {most} allowed", where)


def _limit(message: str, where: Origin) -> ComArmorError:
    return ComArmorError(message, where=where, code="xml-limit")


def _above(path: Path, climbs: int) -> list[Path]:
    """Return the folders above that of a path, up to a number of them."""
    return [each.resolve() for each in path.parents[1 : climbs + 1]]


def _is_uniform(root: etree._Element) -> bool:
    """Tell whether a document itself has rules and includes only, and uses no tunables."""
    parts = root if root.tag == "profiles" else (root,)
    return all(part.tag in PERMISSIONS or part.tag == INCLUDE for part in parts) and not any(
        "@{" in (element.text or "") for element in root.iter()
    )
