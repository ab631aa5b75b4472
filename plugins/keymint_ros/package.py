# SPDX-License-Identifier: Apache-2.0
"""Loads source packages, completed by the defaults of their profile."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from comarmor.errors import Diagnostic, Origin
from comarmor.text import did_you_mean
from comarmor.xml.reader import line
from keymint.api import Authority, CertificateSpec, Governance, Grant, Package, WorkspaceProfile
from keymint.errors import KeymintError
from keymint_ros import certificate, governance, manifest, permissions, placeholders, validity
from keymint_ros.document import Reader, file_in, incomplete, normal_path, text
from keymint_ros.manifest import MARKER, PackageManifest, PackagePart
from keymint_ros.profile import OPEN_GOVERNANCE, base_of

if TYPE_CHECKING:
    from lxml import etree

    from keymint.api import DomainRange, Validity

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class _GrantDefaults:
    line: int
    issuer: str
    domains: tuple[DomainRange, ...]
    subject_name: str | None
    validity: Validity | None


def _identity(root: etree._Element) -> tuple[str, certificate.CertificateElement]:
    (element,) = root.iterfind("identities/identity")
    return element.get("name", "").strip(), certificate.read(element, placeholders.SUBJECT)


def _grant_defaults(root: etree._Element) -> _GrantDefaults:
    return _GrantDefaults(
        line=line(root),
        issuer=text(root.find("issuer_name")) or "",
        domains=governance.domains(root.find("domains")),
        subject_name=placeholders.read(root.find("subject_name"), placeholders.SUBJECT),
        validity=validity.read(root.find("validity")),
    )


_read_identity = Reader("identities", _identity)
_read_identity_defaults = Reader("defaults_identities", lambda root: certificate.read(root, placeholders.SUBJECT))
_read_grant_defaults = Reader("defaults_permissions", _grant_defaults)


@dataclass(frozen=True, slots=True)
class _PackageLoader:
    """Loads one package; each method loads one part.

    Attributes:
        name: the package's name.
        folder: the package's folder as the user would type it.
        base: path of the profile space as the user would type it, ending in a slash; or empty.
        files: the package's files.
        values: values of the placeholders.
    """

    profile: WorkspaceProfile
    name: str
    folder: str
    base: str
    files: Mapping[str, bytes]
    manifest: PackageManifest
    values: Mapping[str, str]

    def own(self, part: PackagePart, create: str = "") -> tuple[str, bytes | None]:
        """Return the path of a part's document, for messages, and its content, or None if there is no document.

        Args:
            part: the part.
            create: help for the error if the document is missing; empty if it is optional.
        """
        where = Origin(self.file(MARKER), part.line)
        path = normal_path(part.path, where)
        content = self.files.get(path)
        if content is None and (part.named or create):
            raise KeymintError(
                f"the package has no {part.path}",
                where=where if part.named else Origin(self.folder),
                help=create or did_you_mean(path, self.files, f"create it, or leave its path out of {MARKER}"),
                code="file-missing",
            )
        return self.file(path), content

    def defaults(self, part: PackagePart) -> tuple[str, bytes]:
        """Return the path, for messages, and the content of a part's defaults in the package or the profile."""
        where = Origin(self.file(MARKER), part.line)
        path = normal_path(part.defaults, where)
        if path in self.files:
            return self.file(path), self.files[path]
        return self.base + path, file_in(self.profile.files, path, where, "package or its profile")

    def file(self, path: str) -> str:
        """Return the path of a file of the package as the user would type it."""
        return f"{self.folder}/{path}"

    def identity(self) -> CertificateSpec:
        """Return the certificate of the subject."""
        file, content = self.own(self.manifest.identities)
        defaults_file, defaults_content = self.defaults(self.manifest.identities)
        own = defaults = replace(_read_identity_defaults(defaults_content, defaults_file), file=defaults_file)
        if content is not None:
            name, element = _read_identity(content, file)
            own = replace(element, file=file)
            if not manifest.is_name_of(name, self.name):
                raise KeymintError(
                    f"the identity is named {name!r}, but the package {self.name!r}",
                    where=own.origin,
                    help="give it the name of the package, or none",
                    code="name-mismatch",
                )
        spec = certificate.complete(own, defaults, self.values)
        self.known_authority(spec.issuer, certificate.issuer(own, defaults)[1], "issues the certificate")
        return spec

    def permissions(self) -> Grant:
        """Return the grant of the subject."""
        part, subject = self.manifest.permissions, f"/{self.name}"
        file, content = self.own(part, create=f"'keymint create {self.name}' creates it from the policy")
        grant = permissions.read(content or b"", file, subject)
        defaults_file, defaults_content = self.defaults(part)
        defaults = _read_grant_defaults(defaults_content, defaults_file)
        subject_name = grant.subject_name or defaults.subject_name
        period = validity.effective(grant.validity, file, defaults.validity, defaults_file)
        if subject_name is None or period is None:
            missing = "subject_name" if subject_name is None else "validity"
            raise incomplete("grant", missing, Origin(defaults_file, defaults.line))
        return Grant(
            issuer=self.signer(part, defaults.issuer, Origin(defaults_file, defaults.line)),
            name=grant.name,
            subject_name=placeholders.expand(subject_name, self.values),
            validity=period,
            domains=grant.domains or defaults.domains or governance.DEFAULT_DOMAINS,
            rules=permissions.to_ir(grant, subject, file, self.base),
            origin=Origin(file, grant.line),
            domains_origin=None if grant.domains else Origin(defaults_file, defaults.line),
            edited=grant.edited,
        )

    def governance(self) -> Governance:
        """Return the protection of the subject's domains."""
        part = self.manifest.governance
        file, content = self.own(part)
        own = () if content is None else governance.read(content, file)
        defaults_file, defaults_content = self.defaults(part)
        defaults = governance.read_defaults(defaults_content, defaults_file)
        return Governance(
            issuer=self.signer(part, defaults.issuer, Origin(defaults_file, defaults.line)),
            domain_rules=governance.complete(own, file, defaults, defaults_file),
            accepts_open=OPEN_GOVERNANCE in self.profile.accepts,
        )

    def signer(self, part: PackagePart, default: str, default_origin: Origin) -> str:
        """Return the authority that signs a document."""
        if part.issuer:
            return self.known_authority(part.issuer, Origin(self.file(MARKER), part.line), "signs this")
        authorities = self.profile.authorities
        only = authorities[0].name if len(authorities) == 1 else ""
        return self.known_authority(default or only, default_origin, "signs this")

    def known_authority(self, name: str, where: Origin, job: str) -> str:
        """Check that the profile has an authority, and return its name."""
        known = [authority.name for authority in self.profile.authorities]
        if name in known:
            return name
        raise KeymintError(
            f"there is no authority {name!r} in the profile"
            if name
            else f"no <issuer_name> names the authority that {job}",
            where=where,
            help=did_you_mean(name, known, f"the profile's authorities are {', '.join(known)}"),
            code="authority-unknown",
        )


def load(profile: WorkspaceProfile, name: str, folder: str, files: Mapping[str, bytes]) -> Package:
    """Load a package: see :meth:`keymint.api.PackageType.load`."""
    file = f"{folder}/{MARKER}"
    package_manifest = manifest.read(file_in(files, MARKER, Origin(folder), "package"), file)
    if not manifest.is_name_of(package_manifest.name, name):
        last = name.rpartition("/")[2]
        raise KeymintError(
            f"the package is named {package_manifest.name!r}, but its folder {name!r}",
            where=Origin(file, package_manifest.name_line),
            help=f"write <name>{last}</name> or leave it out, or move the folder",
            code="name-mismatch",
        )
    subject = f"/{name}"
    values = placeholders.of_subject(subject)
    loader = _PackageLoader(profile, name, folder, base_of(profile), files, package_manifest, values)
    diagnostics: list[Diagnostic] = []
    identity = _attempt(loader.identity, diagnostics)
    grant = _attempt(loader.permissions, diagnostics)
    protection = _attempt(loader.governance, diagnostics)
    if identity is None or grant is None or protection is None:
        raise KeymintError.of(diagnostics)
    if grant.issuer != protection.issuer:
        raise KeymintError(
            f"permissions are signed by {grant.issuer!r}, governance by {protection.issuer!r}",
            where=Origin(file, package_manifest.governance.line),
            help="use the same authority for both: a DDS participant verifies both with one certificate",
            code="signers-differ",
        )
    return Package(
        name=name,
        subject=subject,
        build_type=package_manifest.build_type,
        distro=profile.distro,
        identity=identity,
        grant=grant,
        governance=protection,
        issuers=tuple(_issuers(profile, identity.issuer)),
    )


def _issuers(profile: WorkspaceProfile, name: str) -> Iterator[Authority]:
    """Yield an authority and its issuers up to the root; the profile has no cycle."""
    known = {authority.name: authority for authority in profile.authorities}
    while name in known:
        yield known[name]
        name = known[name].certificate.issuer


def rule_places(name: str, folder: str, files: Mapping[str, bytes]) -> tuple[Origin, ...]:
    """Return the place in the package of each of its rules: see :meth:`keymint.api.RuleLocator.rule_places`."""
    marker = f"{folder}/{MARKER}"
    part = manifest.read(file_in(files, MARKER, Origin(folder), "package"), marker).permissions
    path = normal_path(part.path, Origin(marker, part.line))
    grant = permissions.read(files.get(path, b""), f"{folder}/{path}", f"/{name}")
    return tuple(Origin(f"{folder}/{path}", place.line) for place in grant.places)


def _attempt(part: Callable[[], _T], diagnostics: list[Diagnostic]) -> _T | None:
    """Return a part of the package, or None after adding its errors to the diagnostics."""
    try:
        return part()
    except KeymintError as error:
        diagnostics += error.diagnostics
        return None
