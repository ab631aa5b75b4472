# SPDX-License-Identifier: Apache-2.0
"""New profiles and packages: conservative defaults, written out so that a person can see and change them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from datetime import timedelta
from functools import lru_cache
from pathlib import Path, PurePosixPath
from string import Template

from comarmor.data import locate
from keymint.api import Bootstrap, Role, Validity
from keymint.errors import KeymintError, usage_error
from keymint.pki import periods
from keymint_ros import distros, validity
from keymint_ros.manifest import BUILD_TYPE, MARKER

_SPECIAL = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&#34;", "'": "&#39;"})


def choices(option: str) -> Iterable[str]:
    """See :meth:`keymint.api.ProfileType.choices`."""
    return {"distro": distros.DISTROS, "subject-format": SUBJECT_NAMES}.get(option, ())


def filled_file(path: str, /, **values: object) -> bytes:
    """Return the file of a template.

    Args:
        path: path of the template in ``templates/keymint_ros``.
        values: by name: lines of XML as a tuple, which get the indentation of the line that names them; or a text, that
            is escaped.

    Raises:
        KeyError: the template names a value that is not given.
    """
    lines = {name: value for name, value in values.items() if isinstance(value, tuple)}
    texts = {name: escape_xml(str(value)) for name, value in values.items() if name not in lines}
    template = (locate("keymint_ros", "templates") / path).read_text("utf-8")
    result: list[str] = []
    for line in template.splitlines(keepends=True):
        named = line.strip().removeprefix("$")
        if named in lines:
            indentation = line[: len(line) - len(line.lstrip())]
            result += [f"{indentation}{each}\n".replace("$", "$$") for each in lines[named]]
        else:
            result.append(line)
    return Template("".join(result)).substitute(texts).encode()


def escape_xml(text: str) -> str:
    """Return a text with references for what has a meaning in XML, also within an attribute."""
    return text.translate(_SPECIAL)


_LAYOUTS = ("sros2", "flat")
_TWO_AUTHORITIES, _ONE_AUTHORITY = ("identity_ca", "permissions_ca"), ("ca", "ca")
"""Issuer of identities and signer of permissions; Ardent and Bouncy have one ``ca.cert.pem`` for both."""
SUBJECT_NAMES = {"unique": "OU={unique},CN={common_name}", "sros2": "CN={subject}"}
POLICY_TYPE = "keymint_ros2_comarmor"
"""The policy type of a profile that names none."""
_MAX_DOMAIN = 230
"""Cyclone DDS rejects documents with a larger domain id."""
_AUTHORITY_YEARS = 10
_PACKAGE_YEARS = 1
_EXAMPLE = "comarmor.d"

_PROFILE = (
    "keymint_profile.xml",
    "profile.defaults/authorities.xml",
    "package.defaults/permissions.xml",
    "package.defaults/identities.xml",
)
_DDS, _ZENOH = "keymint_ros2_dds", "keymint_ros2_zenoh"
_DEFAULTS = {_DDS: ("package.defaults/governance.xml",), _ZENOH: ("package.defaults/zenoh.xml",)}
"""By build type: the defaults of the parts that it reads."""
_DOCUMENTS = {_DDS: ("governance.xml",)}
"""By build type: documents of a new package that show how to override these defaults."""

_BUILT_BY = "<!-- What builds new packages: a build type for each transport. Each package names its own. -->"


def bootstrap(request: Bootstrap) -> Mapping[str, bytes]:
    """Return the files of a new profile: see :meth:`keymint.api.ProfileType.bootstrap`."""
    distros.check(request.distro)
    layout = request.layout or distros.layout(request.distro)
    distros.check_choice("layout", layout, _LAYOUTS, "layout-unknown")
    distros.check_choice("subject format", request.subject_format, SUBJECT_NAMES, "subject-format-unknown")
    checked_domain(str(request.domain))
    _check_line("name of the profile", request.name)
    start = periods.begin(request.now)
    issuer, signer = _ONE_AUTHORITY if distros.has_one_authority(request.distro, layout) else _TWO_AUTHORITIES
    if request.authority:
        issuer = signer = request.authority
    build_types = request.build_types or (BUILD_TYPE,)
    dds = _DDS in build_types
    begin = validity.date_text(start)
    end = f"<not_after>{validity.date_text(start + timedelta(days=365 * _PACKAGE_YEARS))}</not_after>"
    if request.valid_for:
        begin = validity.begin_of_period(request.valid_for, request.now)
        end = f"<duration>{escape_xml(request.valid_for)}</duration>"
    period = f"<not_before>{begin}</not_before>", end
    subject_name = SUBJECT_NAMES[request.subject_format]
    values = {
        "name": request.name,
        "distro": request.distro,
        "domain": request.domain,
        "layout": layout,
        "policy_type": request.policy_type or POLICY_TYPE,
        "build_types": () if build_types == (BUILD_TYPE,) else (_BUILT_BY, *_elements(build_types)),
        "reader": "DDS vendor" if dds else "transport",
        "transport_names": "DDS topics" if dds else "names of the transport",
        "why_unique": ", since DDS vendors confuse some names" if dds else "",
        "authorities": tuple(line for each in dict.fromkeys((issuer, signer)) for line in authority(each)),
        "issuer": issuer,
        "signer": signer,
        "subject_name": subject_name,
        "not_before": validity.date_text(start),
        "authority_not_after": validity.date_text(start + timedelta(days=365 * _AUTHORITY_YEARS)),
        "package_validity": period,
        "grant": _grant(subject_name, period) if dds else (),
    }
    defaults = [path for build_type in build_types for path in _DEFAULTS.get(build_type, ())]
    files = {path: filled_file(f"profile/{path}", **values) for path in (*_PROFILE, *defaults)}
    files["authorities.xml"] = filled_file(f"profile/authorities.{'one' if issuer == signer else 'two'}.xml", **values)
    files["policies.xml"] = policies(request.policy or _EXAMPLE)
    fragments = str(distros.library(request.distro))
    for folder, _, names in os.walk(fragments):
        below = f"{_EXAMPLE}{folder.removeprefix(fragments)}"
        files |= {f"{below}/{name}": Path(folder, name).read_bytes() for name in names if name.endswith(".xml")}
    if not request.policy:
        example = "talker_listener.xml"
        files[f"{_EXAMPLE}/{example}"] = (locate("keymint_ros", "templates") / "comarmor.d" / example).read_bytes()
    return files


def policies(path: str) -> bytes:
    """Return the ``policies.xml`` of a profile with one policy.

    Args:
        path: path of the policy, relative to the profile or absolute.

    Raises:
        KeymintError: the path is not one line of printable text.
    """
    _check_line("path of the policy", path)
    return filled_file("profile/policies.xml", name=PurePosixPath(path).stem or "policy", path=path)


@lru_cache
def package(build_types: tuple[str, ...], role: Role = Role.SUBJECT) -> Mapping[str, bytes]:
    """Return the files of a new package with these build types, except its permissions."""
    documents = [name for each in build_types for name in _DOCUMENTS.get(each, ())]
    of_subject = "dds" if _DDS in build_types else "subject"
    template = f"package/keymint_package.{of_subject if role is Role.SUBJECT else 'infrastructure'}.xml"
    files = {name: package_document(name) for name in (*documents, "identities.xml")}
    return {MARKER: filled_file(template, build_types=_elements(build_types)), **files}


@lru_cache
def package_document(name: str) -> bytes:
    """Return a document of a new package: it only has defaults, and shows in comments how to override them."""
    return (locate("keymint_ros", "templates") / "package" / name).read_bytes()


def _elements(build_types: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"<build_type>{escape_xml(each)}</build_type>" for each in build_types)


def authority(name: str, period: Validity | None = None) -> tuple[str, ...]:
    """Return the lines of a new authority, which is self-signed; its period is that of the defaults, or another one."""
    dates: tuple[str, ...] = ()
    if period:
        dates = (f"    {validity.element(period)}",)
    cert = ("  <cert>", *dates, "    <issuer_name></issuer_name>", "  </cert>")
    return (f'<authority name="{escape_xml(name)}">', *cert, "</authority>")


def _grant(subject_name: str, period: Iterable[str]) -> tuple[str, ...]:
    """Return the lines of what only a grant of DDS has."""
    why = "<!-- Must be the subject name of the identity: DDS selects the grant by it. -->"
    name = f"<subject_name>{escape_xml(subject_name)}</subject_name>"
    return why, name, "<validity>", *(f"  {line}" for line in period), "</validity>"


def checked_domain(value: str) -> str:
    """Return the text of a domain id.

    Raises:
        KeymintError: it is none; a usage error.
    """
    if value.isascii() and value.isdecimal() and len(value) <= len(str(_MAX_DOMAIN)) and int(value) <= _MAX_DOMAIN:
        return str(int(value))
    message = f"{value} is not a DDS domain id from 0 to {_MAX_DOMAIN}"
    raise usage_error(message, "use the ROS_DOMAIN_ID of your robots, usually 0", "domain-range")


def _check_line(noun: str, value: str) -> None:
    if not value or value != value.strip() or not value.isprintable() or "  " in value:
        message = f"the {noun} {value!r} is not one line of printable text without surrounding or double spaces"
        raise KeymintError(message, help="choose another one", code="text-invalid")
