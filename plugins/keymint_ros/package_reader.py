# SPDX-License-Identifier: Apache-2.0
"""Loads source packages, completed by the defaults of their profile."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from functools import lru_cache, partial
from itertools import chain
from typing import TypeVar

from lxml import etree

from comarmor.text import did_you_mean
from comarmor.values import Data, replace
from keymint import api
from keymint.api.source_documents import DEFAULT_DOMAINS, Reader, file_in, normal_path, signer
from keymint.errors import Defects, KeymintError, Origin, known_authority
from keymint.ir import Rule, SubjectRules
from keymint.names import subject_of
from keymint_ros import certificate, decisions, manifest, permissions, validity
from keymint_ros.certificate import IssuedElement
from keymint_ros.manifest import ADOPTED, MARKER, SIGNER, PackageManifest, PackagePart
from keymint_ros.profile_reader import base_of

_Issued = TypeVar("_Issued", api.CertificateSpec, api.Grant)


def _identity(root: etree._Element) -> tuple[str, IssuedElement]:
    (element,) = root.iterfind("identities/identity")
    return element.get("name", "").strip(), _element_of_subject(element)


_element_of_subject = partial(certificate.read, known=certificate.SUBJECT_PLACEHOLDERS)
_read_identity = Reader("keymint_ros", "identities", _identity, ("certificate_documents", "package"))
_TOGETHER = {"identities": "certificate_documents", "permissions": "manifest_documents"}
_DEFAULTS = {
    part: Reader("keymint_ros", f"defaults_{part}", _element_of_subject, (together, "defaults"))
    for part, together in _TOGETHER.items()
}
_IDENTITIES, _PERMISSIONS = (f"{part}.xml" for part in _DEFAULTS)
"""The documents of a new package."""


@lru_cache(maxsize=64)
def _read_defaults(part: str, content: bytes, file: str) -> IssuedElement:
    """Return what the defaults of a part say; most packages share one object."""
    return _DEFAULTS[part](content, file).in_file(file)


class _PackageLoader(Data):
    """Loads one package; each method loads one part.

    Attributes:
        name: the package's name.
        folder: the package's folder as the user would type it.
        files: the package's files.
        values: values of the placeholders.
        authorities: names of the profile's authorities.
        built: the package was built from these files.
    """

    profile: api.WorkspaceProfile
    name: str
    folder: str
    files: Mapping[str, bytes]
    manifest: PackageManifest
    values: Mapping[str, str]
    authorities: tuple[str, ...]
    built: bool

    def own(self, part: PackagePart, create: str = "") -> tuple[str, bytes | None]:
        """Return the path of a part's document, for messages, and its content, or None if there is no document.

        Args:
            part: the part.
            create: help for the error if the document is missing; empty if it is optional.
        """
        where = self.place(part)
        path = normal_path(part.path, where)
        content = self.files.get(path)
        if content is None and (part.named or create):
            raise KeymintError(
                f"the package has no {part.path}",
                where=where if part.named else Origin(self.folder),
                help=create or did_you_mean(path, self.files, f"create it, or leave its path out of {MARKER}"),
                code="file-missing",
            )
        return f"{self.folder}/{path}", content

    def defaults(self, name: str, part: PackagePart) -> IssuedElement:
        """Return what a part's defaults in the package or the profile say."""
        file, content = self.optional_defaults(part)
        if content is None:
            content = file_in(self.profile.files, part.defaults, self.place(part), "package or its profile")
        return _read_defaults(name, content, file)

    def optional_defaults(self, part: PackagePart) -> tuple[str, bytes | None]:
        """Return the same; without content if there are no such defaults."""
        path = normal_path(part.defaults, self.place(part))
        if path in self.files:
            return f"{self.folder}/{path}", self.files[path]
        return base_of(self.profile) + path, self.profile.files.get(path)

    def place(self, part: PackagePart) -> Origin:
        """Return the place of a part in the manifest."""
        return Origin(f"{self.folder}/{MARKER}", part.line)

    def identity(self) -> api.CertificateSpec:
        """Return the certificate of the subject."""
        part = self.manifest.part("identities")
        file, content = self.own(part)
        defaults = self.defaults("identities", part)
        own = IssuedElement(defaults.line, defaults.file)
        if content is not None:
            name, element = _read_identity(content, file)
            own = element.in_file(file)
            if not manifest.is_name_of(name, self.name):
                message = f"the identity is named {name!r}, but the package {self.name!r}"
                help_ = "give it the name of the package, or none"
                raise KeymintError(message, where=own.origin, help=help_, code="name-mismatch")
        spec, named_at = certificate.complete(own, defaults, self.values)
        if part.issuer and own.issuer is None:
            spec, named_at = replace(spec, issuer=part.issuer), self.place(part)
        known_authority(spec.issuer, self.authorities, named_at, "issues the certificate")
        return spec

    def grant(self) -> api.Grant:
        """Return the grant of the subject; infrastructure needs no document for it, since its grant has no rules."""
        subject, part = subject_of(self.name), self.manifest.part("permissions")
        if self.manifest.role is api.Role.INFRASTRUCTURE and part.path not in self.files:
            return self._grant_of(SubjectRules(subject, ()))
        file, found = self.own(part, create=f"'keymint create {self.name}' creates it from the policy")
        content = found or b""
        rules = (
            SubjectRules(subject, partial(self._rules, content, file))
            if self.built and permissions.has_rules_only(content, subject)
            else permissions.rendered_rules(content, base_of(self.profile))
        )
        if rules is not None:
            return self._grant_of(rules, IssuedElement(permissions.GRANT_LINE, file))
        grant = permissions.read(content, file, subject)
        rules = permissions.to_ir(grant, subject, file, base_of(self.profile))
        return replace(self._grant_of(rules, grant.own.in_file(file)), name=grant.name, edited=grant.edited)

    def _rules(self, content: bytes, file: str) -> tuple[Rule, ...]:
        grant = permissions.read(content, file, subject_of(self.name))
        return permissions.to_ir(grant, subject_of(self.name), file, base_of(self.profile)).rules

    def _grant_of(self, rules: SubjectRules, written: IssuedElement | None = None) -> api.Grant:
        """Return the grant that its document and the defaults give for some rules.

        Args:
            rules: the rules.
            written: what the document says beside the rules, if there is one.
        """
        part = self.manifest.part("permissions")
        defaults = self.defaults("permissions", part)
        own = written or defaults
        issuer = defaults.issuer or (SIGNER if SIGNER in self.authorities else "")
        return api.Grant(
            issuer=signer(part.issuer, self.place(part), issuer, defaults.origin, self.authorities),
            name=rules.subject,
            subject_name=certificate.expanded_name(own.subject_name or defaults.subject_name or "", self.values),
            validity=own.validity or defaults.validity,
            domains=own.domains or defaults.domains or DEFAULT_DOMAINS,
            rules=rules,
            origin=own.origin,
            domains_origin=defaults.origin if written and not written.domains else None,
            defaults_origin=defaults.origin,
        )

    def part(self, name: str) -> api.SourcePart:
        """Return a part that a build type reads."""
        part = self.manifest.part(name)
        return api.SourcePart(name, *self.own(part), *self.optional_defaults(part), part.issuer, self.place(part))


def load(
    profile: api.WorkspaceProfile,
    name: str,
    folder: str,
    files: Mapping[str, bytes],
    build_types: Callable[[str, Origin], api.BuildType],
    install_space: str,
    *,
    built: bool = False,
) -> api.Package:
    """Load a package: see :meth:`keymint.api.PackageType.load`."""
    file = f"{folder}/{MARKER}"
    package_manifest = manifest.read(file_in(files, MARKER, Origin(folder), "package"), file)
    if not manifest.is_name_of(package_manifest.name, name):
        last = name.rpartition("/")[2]
        message = f"the package is named {package_manifest.name!r}, but its folder {name!r}"
        help_ = f"write <name>{last}</name> or leave it out, or move the folder"
        raise KeymintError(message, where=Origin(file, package_manifest.name_line), help=help_, code="name-mismatch")
    subject = subject_of(name)
    plugins = {each: build_types(each, Origin(file)) for each in package_manifest.build_types}
    defects = Defects()
    issued = defects.attempt(partial(decisions.issuance, folder, files)) or api.Issuance()
    in_common_name = any(each.KNOWS_COMMON_NAMES_ONLY for each in plugins.values())
    values = certificate.placeholder_values(subject, issued.generation, in_common_name=in_common_name)
    authorities = tuple(authority.name for authority in profile.authorities)
    loader = _PackageLoader(profile, name, folder, files, package_manifest, values, authorities, built)
    identity = _renewed(defects.attempt(loader.identity), issued)
    grant = _renewed(defects.attempt(loader.grant), issued)
    of_types = dict.fromkeys(each for plugin in plugins.values() for each in plugin.PARTS)
    attempted = {each: defects.attempt(partial(loader.part, each)) for each in of_types}
    parts = {each: part for each, part in attempted.items() if part}
    sources = api.PackageSources(
        name=name,
        subject=subject,
        role=package_manifest.role,
        distro=profile.distro,
        parts=parts,
        authorities=loader.authorities,
        accepts=profile.accepts,
        install_space=install_space,
        identity=identity,
        grant=grant,
    )
    settings: dict[str, api.PackageSettings] = {}
    for each, plugin in plugins.items():
        if parts.keys() >= set(plugin.PARTS) and (read := defects.attempt(partial(plugin.settings, sources))):
            settings[each] = read
    if identity is None or grant is None or defects.found:
        raise KeymintError.of(defects.found)
    return api.Package(
        name=name,
        subject=subject,
        distro=profile.distro,
        identity=_with_extensions(identity, settings.values()),
        grant=grant,
        build_types=package_manifest.build_types,
        settings={each: read.value for each, read in settings.items()},
        issuers=tuple(_issuers(profile, identity.issuer)),
        role=package_manifest.role,
        issuance=issued,
        kept={path.removeprefix(ADOPTED): each for path, each in files.items() if path.startswith(ADOPTED)},
    )


def load_like(
    profile: api.WorkspaceProfile,
    like: api.Package,
    sources: Mapping[str, bytes],
    name: str,
    folder: str,
    files: Mapping[str, bytes],
) -> api.Package | None:
    """Load a package from another one: see :meth:`keymint.api.PackageType.load_like`."""
    identity, grant = like.identity, like.grant
    others = [file for file, content in files.items() if sources.get(file) != content]
    defaults = tuple(profile.files.get(f"package.defaults/{part}.xml", b"") for part in _DEFAULTS)
    patterns = _patterns(defaults, like.subject, (identity.subject_name, grant.subject_name))
    if others != [_PERMISSIONS] or len(files) != len(sources) or not patterns:
        return None
    if grant.edited or like.issuance != api.Issuance() or like.role is not api.Role.SUBJECT or like.kept:
        return None
    rules = permissions.rendered_rules(files[_PERMISSIONS], base_of(profile))
    if rules is None:
        return None
    values = certificate.placeholder_values(rules.subject)
    own_identity = own_grant = certificate.expanded_name(patterns[0], values)
    if patterns[1] != patterns[0]:
        own_grant = certificate.expanded_name(patterns[1], values)
    place = identity.origin  # in the defaults, unless the package itself says something
    if place.file.endswith(f"/{like.name}/{_IDENTITIES}"):
        place = Origin(f"{folder}/{_IDENTITIES}", place.line)
    spec = api.CertificateSpec(
        own_identity, identity.validity, identity.serial, identity.issuer, identity.hash_algorithm, identity.key,
        identity.extensions, place,
    )  # fmt: skip
    place = Origin(f"{folder}/{_PERMISSIONS}", grant.origin.line)
    own = api.Grant(
        grant.issuer, rules.subject, own_grant, grant.validity, grant.domains, rules, place, grant.domains_origin,
        grant.defaults_origin,
    )  # fmt: skip
    return api.Package(name, rules.subject, like.distro, spec, own, like.build_types, like.settings, like.issuers)


@lru_cache(maxsize=16)
def _patterns(defaults: tuple[bytes, ...], subject: str, names: tuple[str, str]) -> tuple[str, ...]:
    """Return the names with placeholders that defaults give to identity and grant; none if a subject has others."""
    if not all(defaults):
        return ()
    read = (_read_defaults(*each, "").subject_name or "" for each in zip(_DEFAULTS, defaults, strict=True))
    patterns, values = tuple(read), certificate.placeholder_values(subject)
    return patterns if tuple(certificate.expanded_name(each, values) for each in patterns) == names else ()


def _renewed(issued: _Issued | None, issuance_: api.Issuance) -> _Issued | None:
    """Return a certificate or a grant with the validity that it has since it was renewed."""
    if issued is None or issued.validity is None or issuance_.renewed is None:
        return issued
    return replace(issued, validity=validity.renewed_period(issued.validity, issuance_.renewed))


def _with_extensions(identity: api.CertificateSpec, settings: Collection[api.PackageSettings]) -> api.CertificateSpec:
    """Return the identity with the extensions that build types add; an extension of the sources goes first."""
    if not any(of_build_type.extensions for of_build_type in settings):
        return identity
    extensions = {each.name: each for each in identity.extensions}
    for each in chain.from_iterable(of_build_type.extensions for of_build_type in settings):
        extensions.setdefault(each.name, each)
    return replace(identity, extensions=tuple(extensions.values()))


def _issuers(profile: api.WorkspaceProfile, name: str) -> Iterator[api.Authority]:
    """Yield an authority and its issuers up to the root; the profile has no cycle."""
    known = {authority.name: authority for authority in profile.authorities}
    while name in known:
        yield known[name]
        name = known[name].certificate.issuer


def rule_places(name: str, folder: str, files: Mapping[str, bytes]) -> tuple[Origin, ...]:
    """Return the place in the package of each of its rules: see :meth:`keymint.api.PackageType.rule_places`."""
    path = manifest.path_of("permissions", folder, files)
    grant = permissions.read(files.get(path, b""), f"{folder}/{path}", subject_of(name))
    return tuple(Origin(f"{folder}/{path}", place.line) for place in grant.places)
