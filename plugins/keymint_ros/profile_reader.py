# SPDX-License-Identifier: Apache-2.0
"""Loads the profile of a workspace, changes its policy path, and returns its settings as options of ``init``."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from pathlib import Path

from lxml import etree

from comarmor.values import replace
from comarmor.xml.reader import line
from keymint.api import Authority, PolicySource, WorkspaceProfile
from keymint.api.source_documents import Reader, domains, file_in, place, require_new, text
from keymint.errors import KeymintError, Origin, known_authority
from keymint_ros import bootstrap, certificate, decisions, distros, manifest, validity
from keymint_ros.certificate import IssuedElement
from keymint_ros.manifest import BUILD_TYPE

MANIFEST = "keymint_profile.xml"
NAME = "keymint_ros"
LIBRARY = "comarmor.d"

_FORMER = "accept"
"""The former name of <exceptions>."""
_AUTHORITY_DEFAULTS = "profile.defaults/authorities.xml"
_GRANT_DEFAULTS = "package.defaults/permissions.xml"
_IDENTITY_DEFAULTS = "package.defaults/identities.xml"


_PathElement = tuple[str, int]
"""A path in a document, and its line."""
_ProfileManifest = tuple[WorkspaceProfile, tuple[tuple[_PathElement, _PathElement], ...], tuple[_PathElement, ...]]
"""The profile without what its other documents say, pairs of a document of authorities and its defaults, and lists of
policies."""


def _path(parent: etree._Element, tag: str, usual: str) -> _PathElement:
    element = parent.find(tag)
    return (usual, line(parent)) if element is None else (text(element) or "", line(element))


def _manifest(root: etree._Element) -> _ProfileManifest:
    exports = _exports(root)
    distro = root.find("export/distro")
    build_types = manifest.build_types(root.findall("export/build_type")) or (BUILD_TYPE,)
    named = exports.get("distro", "") and distros.check(exports["distro"], place(root if distro is None else distro))
    profile = WorkspaceProfile(
        name=text(root.find("name")) or "",
        profile_type=NAME,
        policy_type=exports.get("policy_type") or bootstrap.POLICY_TYPE,
        package_type=exports.get("package_type") or NAME,
        policies=(),
        library=None,
        authorities=(),
        build_types=build_types,
        layout=exports.get("layout", ""),
        distro=named or distros.DEFAULT,
        files={},
        accepts=frozenset(str(part.tag) for name in ("exceptions", _FORMER) for part in root.iterfind(f"{name}/*")),
        renamed={_FORMER: "exceptions"} if root.find(_FORMER) is not None else {},
        revoke_superseded=root.find("revoke_superseded") is not None,
        distro_named=bool(named),
    )
    authorities = (
        (_path(item, "authority_path", "authorities.xml"), _path(item, "defaults_path", _AUTHORITY_DEFAULTS))
        for item in root.iterfind("authorities/authority")
    )
    policies = (_path(item, "policy_path", "policies.xml") for item in root.iterfind("policies/policy"))
    return profile, tuple(authorities), tuple(policies)


def _exports(root: etree._Element) -> Mapping[str, str]:
    """Return the text of each element of ``<export>`` by its tag.

    Raises:
        KeymintError: an element that may occur once occurs twice.
    """
    exports: dict[str, str] = {}
    for part in root.iterfind("export/*"):
        tag = str(part.tag)
        if tag != "build_type":
            require_new(tag, exports, part, f"there are two elements <{tag}>", "remove one of them", "schema")
        exports[tag] = text(part) or ""
    return exports


_read_element = partial(certificate.read, known=certificate.AUTHORITY_PLACEHOLDERS)


def _authorities(root: etree._Element) -> tuple[tuple[str, IssuedElement], ...]:
    return tuple((each.get("name", "").strip(), _read_element(each)) for each in root.iterfind("authorities/authority"))


def _policies(root: etree._Element) -> tuple[tuple[str, _PathElement], ...]:
    """Return name and path of each policy."""
    return tuple((item.get("name", "").strip(), _policy_path(item)) for item in root.iterfind("policies/policy"))


def _policy_path(policy: etree._Element) -> _PathElement:
    """Return the path of a policy; documents of early 2018 have two elements for it, for the same folder.

    Raises:
        KeymintError: these two name different folders, but an include is relative to the file that has it.
    """
    (*config, path) = policy.iterfind("comarmor/*")
    for each in config:
        if os.path.normpath(text(each) or "") != os.path.normpath(text(path) or ""):
            names = f"<{each.tag}> names another folder than <{path.tag}>"
            element = f"<profile_path>{text(path)}</profile_path>"
            message = f"{names}, but includes are relative to the file that has them"
            help_ = f"move what is included into {text(path)!r}, and write {element} in place of both"
            raise KeymintError(message, where=place(each), help=help_, code="policy-folders")
    return text(path) or "", line(path)


_read_manifest = Reader("keymint_ros", "keymint_profile", _manifest, ("manifest_documents", "profile"))
_read_authorities = Reader("keymint_ros", "authorities", _authorities, ("certificate_documents", "profile"))
_read_authority_defaults = Reader(
    "keymint_ros", "defaults_authorities", _read_element, ("certificate_documents", "defaults")
)
_read_policies = Reader("keymint_ros", "policies", _policies, ("rights_documents", "profile"))


def base_of(profile: WorkspaceProfile) -> str:
    """Return the path of the profile space as the user would type it, ending in a slash; or empty."""
    return _base_of(profile.library or "")


@lru_cache(maxsize=4)
def _base_of(library: str) -> str:
    folder = posixpath.dirname(library)
    return folder and f"{folder.rstrip('/')}/"


def recognises(files: Mapping[str, bytes]) -> bool:
    """Tell whether a profile space with these files is of this type."""
    return MANIFEST in files


def load(root: Path, files: Mapping[str, bytes]) -> WorkspaceProfile:
    """Load a profile: see :meth:`keymint.api.ProfileType.load`."""
    content = file_in(files, MANIFEST, Origin(str(root)), "profile")
    profile, listed, policies = _read_manifest(content, str(root / MANIFEST))
    authorities: dict[str, Authority] = {}
    issuers: dict[str, Origin] = {}
    for path, defaults_path in listed:
        content, file = _document(root, files, path)
        defaults_content, defaults_file = _document(root, files, defaults_path)
        defaults = _read_authority_defaults(defaults_content, defaults_file).in_file(defaults_file)
        for name, element in _read_authorities(content, file):
            own = element.in_file(file)
            spec, issuer_named_at = certificate.complete(own, defaults, {"name": name})
            # Names must differ even on a file system that ignores case.
            if name.lower() in {other.lower() for other in authorities}:
                message = f"there are two authorities named {name!r}"
                help_ = "give each its own name, different in more than case: it becomes the name of a file"
                raise KeymintError(message, where=own.origin, help=help_, code="authority-doubled")
            authorities[name] = Authority(name, replace(spec, issuer="" if spec.issuer == name else spec.issuer))
            issuers[name] = issuer_named_at
    for each, issuance in decisions.authority_issuance(files, str(root), authorities).items():
        spec = decisions.spec_after_decision(authorities[each].certificate, issuance)
        authorities[each] = Authority(each, spec, issuance)
    _check_hierarchy(authorities, issuers)
    return replace(
        profile,
        policies=tuple(source for path in policies for source in _load_policies(root, files, path)),
        library=root / LIBRARY,
        authorities=tuple(authorities.values()),
        layout=profile.layout or "sros2",
        files=files,
        packages=decisions.accepted_packages(files, str(root)),
        package_copies=root / decisions.COPIES,
    )


def with_distro(profile: WorkspaceProfile, distro: str) -> WorkspaceProfile:
    """Return a profile with a distribution: see :meth:`keymint.api.ProfileType.with_distro`."""
    layout = _read_manifest(profile.files[MANIFEST], MANIFEST)[0].layout
    # What no node of the distribution could read stays where it would be without one.
    is_readable = len(profile.authorities) == 1 or not distros.has_one_authority(distro, distros.layout(distro))
    return replace(profile, distro=distro, layout=layout or (distros.layout(distro) if is_readable else profile.layout))


def _document(root: Path, files: Mapping[str, bytes], path: _PathElement) -> tuple[bytes, str]:
    """Return the content of a document that the manifest names, and its path as the user would type it."""
    name, at = path
    return file_in(files, name, Origin(f"{root}/{MANIFEST}", at), "profile"), str(root / name)


def _check_hierarchy(authorities: Mapping[str, Authority], issuers: Mapping[str, Origin]) -> None:
    """Check that every chain of issuers ends in a self-signed authority of the profile."""
    for name in authorities:
        chain = [name]
        while issuer := authorities[chain[-1]].certificate.issuer:
            where = issuers[chain[-1]]
            help_ = "leave <issuer_name> empty for a self-signed authority"
            known_authority(issuer, authorities, where, help_=help_)
            if issuer in chain:
                message = f"authorities issue each other in a cycle: {' <- '.join([*chain, issuer])}"
                help_ = "leave the <issuer_name> of the root authority empty"
                raise KeymintError(message, where=where, help=help_, code="authority-cycle")
            chain.append(issuer)


def _load_policies(root: Path, files: Mapping[str, bytes], path: _PathElement) -> Iterator[PolicySource]:
    """Yield the policies of one document."""
    content, file = _document(root, files, path)
    for name, (policy, at) in _read_policies(content, file):
        yield PolicySource(name, Path(os.path.normpath(root / policy)), Origin(file, at))


def with_policy(files: Mapping[str, bytes], policy: str) -> Mapping[str, bytes]:
    """Return the files that change with the policy: see :meth:`keymint.api.ProfileType.with_policy`."""
    _, _, (path, *others) = _read_manifest(file_in(files, MANIFEST, Origin(MANIFEST), "profile"), MANIFEST)
    content, file = _document(Path(), files, path)
    (present, at), *more = [each for _, each in _read_policies(content, file)]
    if not others and not more and present == policy:
        return {}
    if others or more or content != _as_written(present):
        message = f"not replacing the profile's policies by {policy!r}: they were edited by hand"
        help_ = f"write <profile_path>{policy}</profile_path> into this file, or create a new workspace"
        raise KeymintError(message, where=Origin(file, at), help=help_, code="policies-edited")
    return {path[0]: bootstrap.policies(policy)}


def _as_written(policy: str) -> bytes:
    """Return the list that Keymint writes of a policy; empty if it would not write a path like this."""
    try:
        return bootstrap.policies(policy)
    except KeymintError:
        return b""


def settings(profile: WorkspaceProfile) -> Mapping[str, str]:
    """Return the value of each option of ``init``: see :meth:`keymint.api.ProfileType.settings`."""
    found: dict[str, str] = {}
    for file, read in ((_IDENTITY_DEFAULTS, _read_identity_settings), (_GRANT_DEFAULTS, _read_grant_settings)):
        if content := profile.files.get(file):
            found |= read(content, base_of(profile) + file)
    return {"distro": profile.distro, "layout": profile.layout, **found}


def _settings(root: etree._Element) -> Mapping[str, str]:
    """Return what the defaults of grants or identities set; the latter have no domains."""
    ranges = (
        f"{each.first}-{each.last}" if each.first < each.last else f"{each.first}"
        for each in domains(root.find("domains"))
    )
    subject_name = text(root.find("subject_name")) or ""
    formats = {name: format_ for format_, name in bootstrap.SUBJECT_NAMES.items()}
    found = {
        "domain": ", ".join(ranges),
        "subject-format": formats.get(subject_name, subject_name),
        "valid-for": validity.length(root),
    }
    return {name: value for name, value in found.items() if value}


_read_grant_settings = Reader("keymint_ros", "defaults_permissions", _settings)
_read_identity_settings = Reader("keymint_ros", "defaults_identities", _settings)
