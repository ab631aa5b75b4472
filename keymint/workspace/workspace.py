# SPDX-License-Identifier: Apache-2.0
"""A workspace: its root, its spaces, and the packages in its source space."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import accumulate, permutations
from pathlib import Path

from comarmor.text import quote
from comarmor.values import Data, replace
from keymint import SPACES
from keymint.errors import Diagnostic, ExitCode, KeymintError, Origin
from keymint.names import RESERVED, package_name
from keymint.store.changes import File, FolderChange, Plan
from keymint.view.file_reading import REGISTER, file_error
from keymint.view.tree import Tree

PROFILE_MARKER = "keymint_profile.xml"
PACKAGE_MARKER = "keymint_package.xml"
IGNORE_MARKER = RESERVED
DEFAULTS = "package.defaults"
"""Folder of a package that has defaults of its own."""
GITIGNORE = ".gitignore"
"""The file at the top of spaces that git keeps out of."""
_IGNORES_ALL = b"# Secrets, or files that Keymint can make again: none of them belongs into git.\n*\n"


class Workspace(Data):
    """Absolute paths of a workspace and its spaces.

    Attributes:
        root: the folder that contains the spaces, unless an option puts one elsewhere.
        profile: authorities, defaults and policy, written by people.
        private: private keys; mode 0700.
        public: certificates of the authorities.
        src: source packages, one per subject.
        build: unsigned documents.
        install: the enclaves to deploy.
        shown_from: folder that paths in messages are relative to.
    """

    root: Path
    profile: Path
    private: Path
    public: Path
    src: Path
    build: Path
    install: Path
    shown_from: Path

    @classmethod
    def at(cls, root: Path, spaces: Mapping[str, Path], shown_from: Path) -> Workspace:
        """Return the workspace at a root.

        Args:
            root: the root; need not exist.
            spaces: paths of spaces that are not in their default place, absolute or relative to the root.
            shown_from: folder that paths in messages are relative to.

        Raises:
            KeymintError: two spaces are the same folder, or one contains another.
        """
        root = root.resolve()
        paths = {space: (root / spaces[space]).resolve() if space in spaces else root / space for space in SPACES}
        texts = {space: f"{path}/".replace("//", "/") for space, path in paths.items()}
        for one, other in permutations(SPACES, 2):
            if texts[one].startswith(texts[other]):
                message = f"the {one} space {paths[one]} is inside the {other} space {paths[other]}"
                help_ = "give each space a folder of its own"
                raise KeymintError(message, help=help_, code="space-overlap", exit_code=ExitCode.USAGE)
        return cls(root=root, shown_from=shown_from, **paths)

    @property
    def state(self) -> Path:
        """The folder of Keymint's own records."""
        return self.root / ".keymint"

    def spaces(self) -> tuple[Path, ...]:
        """Return the folders of all spaces, and of a second keystore if there is one."""
        spaces = tuple(getattr(self, space) for space in SPACES)
        return (*spaces, self.next_install) if self.next_install.is_dir() else spaces

    @property
    def next_install(self) -> Path:
        """The folder of a second keystore, while the key of an authority is replaced."""
        return self.install.with_name(f"{self.install.name}.next")

    def exists(self) -> bool:
        """Tell whether there is a profile."""
        return (self.profile / PROFILE_MARKER).is_file()

    def shown(self, path: Path | str) -> str:
        """Return a path as the user would type it."""
        return shown_path(path, self.shown_from)

    def origin(self, path: Path | str) -> Origin:
        """Return a file as the place that a message is about."""
        return Origin(self.shown(path))

    def authority_key(self, name: str) -> Path:
        """Return the path of an authority's private key."""
        return self.private / f"{name}.key.pem"

    def authority_certificate(self, name: str) -> Path:
        """Return the path of an authority's certificate."""
        return self.public / f"{name}.cert.pem"

    def revocation_list(self, name: str) -> Path:
        """Return the path of an authority's revocation list."""
        return self.public / f"{name}.crl.pem"

    @property
    def register(self) -> Path:
        """The register of issued certificates."""
        return self.private / REGISTER

    @property
    def log(self) -> Path:
        """The log of runs, by which nothing is decided."""
        return self.private / "runs.jsonl"

    @property
    def identities(self) -> str:
        """The folder of the private keys of subjects."""
        return f"{self.private}/identities"

    def identity_key(self, package: str) -> str:
        """Return the path of the private key of a package's subject."""
        return f"{self.identities}/{package}/key.pem"


def shown_path(path: Path | str, start: Path) -> str:
    """Return a path relative to a folder if it is below or near it, else unchanged."""
    text, root = str(path), str(start)
    below = root if root.endswith("/") else f"{root}/"
    if text.startswith(below):
        return text.removeprefix(below)
    if root.startswith(text) or not text.startswith("/"):
        relative = os.path.relpath(text, root)
    else:
        folder, _, name = text.rpartition("/")
        relative = os.path.join(_beside(folder or "/", root), name)  # noqa: PTH118 - of texts
    return relative if relative.count("..") <= 2 else text  # noqa: PLR2004 - beyond, nobody counts the dots


def with_place(diagnostic: Diagnostic, space: Path) -> Diagnostic:
    """Return a diagnostic whose file, which a plugin gives relative to a space, has its full path."""
    where = diagnostic.where
    if where is None or where.file.startswith("/"):
        return diagnostic
    return replace(diagnostic, where=replace(where, file=str(space / where.file)))


@lru_cache(maxsize=1 << 14)
def _beside(folder: str, root: str) -> str:
    """Return a folder relative to another one; cached, because every file that messages may name asks for it."""
    return os.path.relpath(folder, root)


def find(start: Path, spaces: Mapping[str, Path], shown_from: Path, named: Path | None = None) -> Workspace:
    """Return the workspace that contains a folder, searching upward as git does; a path that was named is told.

    Raises:
        KeymintError: there is none.
    """
    missing = named is not None and not start.is_dir()
    for folder in () if missing else (start.resolve(), *start.resolve().parents):
        workspace = Workspace.at(folder, spaces, shown_from)
        if workspace.exists():
            return workspace
    message = f"Not inside a Keymint workspace (no profile/{PROFILE_MARKER} in this or any parent directory)"
    help_ = "correct the path, or run 'keymint init'" if named else "run 'keymint init', or set the workspace with -w"
    raise KeymintError(message, where=Origin(str(named)) if named else None, help=help_, code="workspace-missing")


def packages(tree: Tree, src: Path) -> tuple[str, ...]:
    """Return the names of the source packages, sorted.

    A folder with a regular file ``KEYMINT_IGNORE`` is not searched, nor are hidden folders and links.

    Raises:
        KeymintError: the folder of a package is not a legal name.
    """
    return tuple(sorted(_packages(tree, str(src), "")))


def _packages(tree: Tree, folder: str, name: str) -> Iterator[str]:
    entries = dict(tree.names(folder))
    if entries.get(IGNORE_MARKER) is False and tree.has_file(f"{folder}/{IGNORE_MARKER}"):
        return
    if name and entries.get(PACKAGE_MARKER) is False:
        try:
            yield package_name(name)
        except KeymintError as error:
            raise error.at(Origin(folder)) from None
    for entry, is_folder in entries.items():
        if is_folder and not entry.startswith(".") and not entry.endswith(".defaults"):
            yield from _packages(tree, f"{folder}/{entry}", f"{name}/{entry}" if name else entry)


def hidden_by(tree: Tree, src: Path, name: str) -> Path | None:
    """Return the file ``KEYMINT_IGNORE`` that hides a package of this name, or None."""
    folders = accumulate(name.split("/"), Path.joinpath, initial=src)
    return next((folder / IGNORE_MARKER for folder in folders if tree.has_file(folder / IGNORE_MARKER)), None)


def package_paths(tree: Tree, workspace: Workspace, name: str) -> dict[str, str]:
    """Return the paths of the XML files of a package's folder, by their name in the package.

    Raises:
        KeymintError: ``package.defaults`` is a link that leads nowhere, or out of the workspace.
    """
    folder = f"{workspace.src}/{name}"
    entries = tree.names(folder)
    names = [entry for entry, is_folder in entries if entry.endswith(".xml") and not is_folder]
    for entry, is_folder in entries:
        if entry == DEFAULTS and (is_folder or _has_own_defaults(workspace, f"{folder}/{DEFAULTS}")):
            inner = tree.names(f"{folder}/{DEFAULTS}")
            names += [f"{DEFAULTS}/{file}" for file, is_folder in inner if file.endswith(".xml") and not is_folder]
    return {file: f"{folder}/{file}" for file in names}


def _has_own_defaults(workspace: Workspace, path: str) -> bool:
    """Tell whether a link ``package.defaults`` leads to other defaults than those of the profile.

    The tool of 2018 linked those of the profile, by an absolute path, into each package. Such a link dangles once the
    workspace has moved.

    Raises:
        KeymintError: it leads nowhere, or out of the workspace.
    """
    if not os.path.islink(path):  # noqa: PTH114 - of a text
        return False
    target, shared = os.path.realpath(path), f"{workspace.profile}/{DEFAULTS}"
    is_there = os.path.isdir(target)  # noqa: PTH112 - of a text
    moved = not is_there and target.endswith(f"/{workspace.profile.name}/{DEFAULTS}")
    if moved or target == os.path.realpath(shared):
        return False
    if is_there and Path(target).is_relative_to(workspace.root):
        return True
    message = f"is a link to {quote(target, 200)}, which is {'outside the workspace' if is_there else 'no folder'}"
    help_ = f"remove it, so that {workspace.shown(shared)} applies, or put a copy of the right folder in its place"
    raise file_error(path, "symlink-refused", message, help_)


def missing_gitignores(workspace: Workspace, plan: Plan) -> Sequence[FolderChange]:
    """Return the missing ``.gitignore`` files of the spaces that a plan writes to, or that exist.

    They keep git out of spaces with secrets or generated files. Each such space has one at its top, wherever an option
    puts the space. No enclave contains one, so none is copied to a robot.

    An existing file belongs to the user and is kept. A space that is a link or read-only is skipped, unless the plan
    writes to it anyway.
    """
    spaces = (workspace.private, workspace.build, workspace.install, workspace.next_install, workspace.state)
    present = (space for space in spaces if space != workspace.next_install and space.is_dir())
    kept = [space for space in present if not space.is_symlink() and os.access(space, os.W_OK)]

    def is_written(space: Path) -> bool:
        place = "" if space == workspace.state else f"{space}/"  # whatever is written, there is the record of it
        return any(f"{folder}/".startswith(place) for folder, names, _ in plan.names() if names)

    return [
        FolderChange(space, {GITIGNORE: File(_IGNORES_ALL)}, private=space == workspace.private)
        for space in spaces
        if not os.path.lexists(space / GITIGNORE) and (space in kept or is_written(space))
    ]
