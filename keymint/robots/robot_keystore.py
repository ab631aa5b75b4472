# SPDX-License-Identifier: Apache-2.0
"""The keystore of a robot: its enclaves, the authorities that they trust, and the requests that wait for an answer.

``.keymint/requests/NAME/`` in the keystore has the request of an enclave, and the private key that it is for if this is
not the one that the enclave has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cryptography import x509

from comarmor.values import Data, field
from keymint.errors import KeymintError, Origin
from keymint.names import ROOT
from keymint.pki import certificates
from keymint.robots import certification_request as requests
from keymint.robots.bundle import CERTIFICATE, KEY, certificates_of_authorities, issuing_files, revocation_lists
from keymint.robots.certification_request import CertificationRequest
from keymint.store.changes import File, FolderChange
from keymint.view.tree import Tree

RECORDS = ".keymint"
"""The folder of Keymint's own records."""
ENCLAVES = ("enclaves", "")
"""Folders below a keystore that may have the enclaves, one in each layout; see :class:`keymint.api.Layout`."""
_REQUEST = "request.pem"


class Pending(Data):
    """A request that waits for its answer: the request, and its private key (PEM) unless the enclave has it."""

    request: CertificationRequest
    key: bytes = field(default=b"", repr=False)


class Present(Data):
    """What a keystore has, as far as it matters to one enclave.

    Attributes:
        folder: the enclave's folder as the user would type it.
        files: the enclave's files by name; empty if the keystore does not have it.
        pending: its request that waits for an answer.
        known: fingerprints of the keys of authorities that some enclave of the keystore trusts, by name of their file.
        issuing: names of those files whose authorities issue certificates of enclaves.
        lists: the revocation lists that its enclaves have.
    """

    folder: str
    files: Mapping[str, bytes] = field(repr=False)
    pending: Pending | None
    known: Mapping[str, frozenset[str]]
    issuing: frozenset[str]
    lists: tuple[x509.CertificateRevocationList, ...] = ()


class Keystore:
    """The keystore of a robot, read once.

    Attributes:
        root: its absolute path; need not exist.
        shown: the path as the user would type it.
    """

    def __init__(self, root: Path, shown: str) -> None:
        self.root = root
        self.shown = shown
        self._tree = Tree()

    def folder(self, enclaves: str, name: str) -> Path:
        """Return the folder of an enclave.

        Args:
            enclaves: the folder of all enclaves below the keystore; empty for the keystore itself.
            name: name of the enclave's package.
        """
        return self.root / enclaves if name == ROOT else self.root / enclaves / name

    def present(self, enclaves: str, name: str) -> Present:
        """Return what the keystore has; arguments as for :meth:`folder`.

        Raises:
            KeymintError: a file cannot be read, or is a link.
        """
        folder = self.folder(enclaves, name)
        shown = f"{self.shown}/{folder.relative_to(self.root)}"
        return Present(shown, self._files(folder), self.pending(name), *self._known())

    def installed(self, name: str) -> Mapping[str, bytes]:
        """Return the files of an enclave in whatever layout; empty if the keystore does not have it."""
        layouts = (each for each in ENCLAVES if each or name != ROOT)
        return next(filter(None, (self._files(self.folder(each, name)) for each in layouts)), {})

    def _files(self, folder: Path) -> Mapping[str, bytes]:
        names = [name for name, is_folder in self._tree.names(folder) if not is_folder and not name.startswith(".")]
        contents = {name: self._tree.read(folder / name) for name in names}
        return {name: content for name, content in contents.items() if content is not None}

    def _known(
        self,
    ) -> tuple[Mapping[str, frozenset[str]], frozenset[str], tuple[x509.CertificateRevocationList, ...]]:
        """Return the fingerprints of the keys of the authorities that enclaves trust, by name of their file.

        And the names of those files whose authorities issue certificates of enclaves, and the revocation lists.
        """
        known: dict[str, set[str]] = {}
        issuing: set[str] = set()
        lists: list[x509.CertificateRevocationList] = []
        for folder in self._folders(str(self.root)):
            files = {name: self._tree.try_read(f"{folder}/{name}") or b"" for name, _ in self._tree.names(folder)}
            chains: dict[str, tuple[x509.Certificate, ...]] = {}
            for file, content in files.items():
                with suppress(KeymintError):  # what cannot be read is trusted by nobody
                    chains |= certificates_of_authorities({file: content})
            for file, chain in chains.items():
                known.setdefault(file, set()).update(map(certificates.fingerprint, chain))
            issuing |= issuing_files(files[CERTIFICATE], chains)
            with suppress(ValueError):  # a damaged list says of nobody that it is revoked
                lists += revocation_lists(files)
        return {name: frozenset(each) for name, each in known.items()}, frozenset(issuing), tuple(lists)

    def _folders(self, folder: str) -> Iterator[str]:
        """Yield the folders of enclaves: those with a certificate of an identity."""
        entries = self._tree.names(folder)
        if any(name == CERTIFICATE and not is_folder for name, is_folder in entries):
            yield folder
        for name, is_folder in entries:
            if is_folder and not name.startswith("."):
                yield from self._folders(f"{folder}/{name}")

    # -- requests ------------------------------------------------------------------------------------------------

    def _waiting(self, name: str) -> Path:
        return self.root / RECORDS / "requests" / name

    def request(self, name: str) -> bytes | None:
        """Return the file of the request that an enclave made last, or None if none waits for its answer."""
        return self._tree.read(self._waiting(name) / _REQUEST)

    def pending(self, name: str) -> Pending | None:
        """Return the request that an enclave made last, or None if none waits for its answer.

        Raises:
            KeymintError: it is damaged.
        """
        content = self.request(name)
        if content is None:
            return None
        where = Origin(f"{self.shown}/{RECORDS}/requests/{name}/{_REQUEST}")
        key = self._tree.read(self._waiting(name) / KEY)
        return Pending(requests.read(content, where), key or b"")

    # -- changes -------------------------------------------------------------------------------------------------

    def wait(self, name: str, request: bytes, key: bytes) -> FolderChange:
        """Return the change that keeps a request, and its private key unless that is empty."""
        files = {_REQUEST: File(request, secret=True), **({KEY: File(key, secret=True)} if key else {})}
        return FolderChange(self._waiting(name), files, () if key else (KEY,), private=True)

    def forget(self, name: str) -> FolderChange:
        """Return the change that removes the request of an enclave."""
        return FolderChange(self._waiting(name), removed=(_REQUEST, KEY))

    def take(self, enclaves: str, name: str, changed: Mapping[str, bytes], removed: Sequence[str]) -> FolderChange:
        """Return the change that makes an enclave what its bundle says.

        Args:
            enclaves: as for :meth:`folder`.
            name: as for :meth:`folder`.
            changed: files that change, by name.
            removed: names of files that go.
        """
        files = {file: File(content, secret=file == KEY) for file, content in changed.items()}
        return FolderChange(self.folder(enclaves, name), files, tuple(removed), private=True)
