"""The profile of a workspace: loaded, and bound to another policy."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from comarmor.errors import Origin
from comarmor.text import did_you_mean
from keymint.api import Authority, PolicySource, WorkspaceProfile
from keymint.errors import KeymintError
from keymint_ros import bootstrap, certificate, distros, placeholders
from keymint_ros.document import Reader, file_in, line, place, text
from keymint_ros.manifest import BUILD_TYPE

if TYPE_CHECKING:
    from lxml import etree

MANIFEST = "keymint_profile.xml"
NAME = "keymint_ros"
LIBRARY = "comarmor.d"
OPEN_GOVERNANCE = "open_governance"
"""Name of the option that accepts what the governance of the packages leaves without access control."""

_POLICY_TYPE = "keymint_ros2_comarmor"
_AUTHORITY_DEFAULTS = "profile.defaults/authorities.xml"


@dataclass(frozen=True, slots=True)
class _Path:
    """A path that a document names, and the line where it does."""

    path: str
    line: int


@dataclass(frozen=True, slots=True)
class _Manifest:
    """What ``keymint_profile.xml`` says."""

    name: str
    authorities: tuple[tuple[_Path, _Path], ...]
    policies: tuple[_Path, ...]
    policy_type: str
    package_type: str
    build_type: str
    layout: str
    distro: str
    distro_line: int
    accepts: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Policy:
    """A policy that ``policies.xml`` names."""

    name: str
    path: str
    line: int


def _path(element: etree._Element | None, parent: etree._Element, usual: str) -> _Path:
    return _Path(usual, line(parent)) if element is None else _Path(text(element) or "", line(element))


def _manifest(root: etree._Element) -> _Manifest:
    said = {part.tag: text(part) or "" for part in root.iterfind("export/*")}
    distro = root.find("export/distro")
    return _Manifest(
        name=text(root.find("name")) or "",
        authorities=tuple(
            (
                _path(item.find("authority_path"), item, "authorities.xml"),
                _path(item.find("defaults_path"), item, _AUTHORITY_DEFAULTS),
            )
            for item in root.iterfind("authorities/authority")
        ),
        policies=tuple(
            _path(item.find("policy_path"), item, "policies.xml") for item in root.iterfind("policies/policy")
        ),
        policy_type=said.get("policy_type") or _POLICY_TYPE,
        package_type=said.get("package_type") or NAME,
        build_type=said.get("build_type") or BUILD_TYPE,
        layout=said.get("layout") or "sros2",
        distro=said.get("distro") or distros.DEFAULT,
        distro_line=line(root if distro is None else distro),
        accepts=frozenset(str(part.tag) for part in root.iterfind("accept/*")),
    )


def _authorities(root: etree._Element) -> tuple[tuple[str, certificate.Written], ...]:
    found: dict[str, certificate.Written] = {}
    for element in root.iterfind("authorities/authority"):
        name = element.get("name", "").strip()
        _unique(name, found, place(element))
        found[name] = certificate.read(element, placeholders.AUTHORITY)
    return tuple(found.items())


def _unique(name: str, known: Mapping[str, object], where: Origin) -> None:
    """Check that an authority's name is new, also on a file system that ignores case."""
    if name.lower() in {other.lower() for other in known}:
        raise KeymintError(
            f"there are two authorities named {name!r}",
            where=where,
            help="names of authorities name files: give each its own, not only by upper and lower case",
            code="authority-doubled",
        )


def _policies(root: etree._Element) -> tuple[_Policy, ...]:
    return tuple(
        _Policy(item.get("name", "").strip(), text(path) or "", line(path))
        for item in root.iterfind("policies/policy")
        for path in item.iterfind("comarmor/profile_path")
    )


_read_manifest = Reader("keymint_profile", _manifest)
_read_authorities = Reader("authorities", _authorities)
_read_authority_defaults = Reader("defaults_authorities", lambda root: certificate.read(root, placeholders.AUTHORITY))
_read_policies = Reader("policies", _policies)


def build_type(profile: WorkspaceProfile) -> str:
    """Return the build type that packages of a profile are created with."""
    content = profile.files.get(MANIFEST)
    return BUILD_TYPE if content is None else _read_manifest(content, MANIFEST).build_type


def base_of(profile: WorkspaceProfile) -> str:
    """Return the profile space, ending in a slash, as the user would type it; or empty."""
    folder = "." if profile.library is None else str(profile.library.parent)
    return "" if folder == "." else f"{folder.rstrip('/')}/"


def recognises(files: Mapping[str, bytes]) -> bool:
    """Tell whether these files of a profile space are of this type."""
    return MANIFEST in files


def load(root: Path, files: Mapping[str, bytes]) -> WorkspaceProfile:
    """Load a profile: see :meth:`keymint.api.ProfileType.load`."""
    name = str(root / MANIFEST)
    said = _read_manifest(file_in(files, MANIFEST, Origin(str(root)), "profile"), name)
    distros.check(said.distro, Origin(name, said.distro_line))
    authorities: dict[str, Authority] = {}
    issuers: dict[str, Origin] = {}
    for path, defaults_path in said.authorities:
        for authority, origin in _load_authorities(root, files, name, path, defaults_path):
            _unique(authority.name, authorities, authority.certificate.origin)
            authorities[authority.name], issuers[authority.name] = authority, origin
    _check_hierarchy(authorities, issuers)
    return WorkspaceProfile(
        name=said.name,
        profile_type=NAME,
        policy_type=said.policy_type,
        package_type=said.package_type,
        policies=_load_policies(root, files, name, said.policies),
        library=root / LIBRARY,
        authorities=tuple(authorities.values()),
        layout=said.layout,
        distro=said.distro,
        files=files,
        accepts=said.accepts,
    )


def _load_authorities(
    root: Path, files: Mapping[str, bytes], manifest: str, path: _Path, defaults_path: _Path
) -> list[tuple[Authority, Origin]]:
    """Return the authorities of one document, each with the place where its issuer is named."""
    content = file_in(files, path.path, Origin(manifest, path.line), "profile")
    defaults_content = file_in(files, defaults_path.path, Origin(manifest, defaults_path.line), "profile")
    file, defaults_file = str(root / path.path), str(root / defaults_path.path)
    defaults = certificate.Source(defaults_file, _read_authority_defaults(defaults_content, defaults_file))
    found = []
    for name, written in _read_authorities(content, file):
        own = certificate.Source(file, written)
        spec = certificate.complete(own, defaults, {"name": name})
        issuer = "" if spec.issuer == name else spec.issuer
        found.append((Authority(name, replace(spec, issuer=issuer)), certificate.issuer(own, defaults)[1]))
    return found


def _check_hierarchy(authorities: Mapping[str, Authority], issuers: Mapping[str, Origin]) -> None:
    """Check that every chain of issuers ends in a self-signed authority of the profile."""
    for name in authorities:
        chain = [name]
        while issuer := authorities[chain[-1]].certificate.issuer:
            where = issuers[chain[-1]]
            if issuer not in authorities:
                raise KeymintError(
                    f"the authority {chain[-1]!r} is issued by {issuer!r}, which the profile does not have",
                    where=where,
                    help=did_you_mean(issuer, authorities, "leave <issuer_name> empty for a self-signed authority"),
                    code="authority-unknown",
                )
            if issuer in chain:
                raise KeymintError(
                    f"authorities issue each other in a circle: {' <- '.join([*chain, issuer])}",
                    where=where,
                    help="leave <issuer_name> of the root empty",
                    code="authority-cycle",
                )
            chain.append(issuer)


def _load_policies(
    root: Path, files: Mapping[str, bytes], manifest: str, paths: Sequence[_Path]
) -> tuple[PolicySource, ...]:
    found: list[PolicySource] = []
    for path in paths:
        content = file_in(files, path.path, Origin(manifest, path.line), "profile")
        file = str(root / path.path)
        found += (
            PolicySource(policy.name, Path(os.path.normpath(root / policy.path)), Origin(file, policy.line))
            for policy in _read_policies(content, file)
        )
    return tuple(found)


def with_policy(files: Mapping[str, bytes], policy: str) -> Mapping[str, bytes]:
    """Return the files that change with the policy: see :meth:`keymint.api.ProfileType.with_policy`."""
    said = _read_manifest(file_in(files, MANIFEST, Origin(MANIFEST), "profile"), MANIFEST)
    (path, *others) = said.policies
    content = file_in(files, path.path, Origin(MANIFEST, path.line), "profile")
    policies = _read_policies(content, path.path)
    if not others and [one.path for one in policies] == [policy]:
        return {}
    if others or len(policies) != 1 or content != bootstrap.policies(policies[0].path):
        raise KeymintError(
            f"the profile's policies were edited by hand, so that they are not replaced by {policy!r}",
            where=Origin(path.path, policies[0].line),
            help=f"write <profile_path>{policy}</profile_path> into it, or start a new workspace",
            code="policies-edited",
        )
    return {path.path: bootstrap.policies(policy)}
