# SPDX-License-Identifier: Apache-2.0
"""The sources of a package whose certificate and documents another tool made: its dates, its name, and what is kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from keymint.api import AdoptedSources, DomainRange, KeySpec, WorkspaceProfile
from keymint_ros import bootstrap, permissions_writer, validity
from keymint_ros.profile_reader import base_of
from keymint_ros.templates import filled_file

PREFIX = "adopted."
"""Prefix of the files of a package that are documents which another tool signed: ``adopted.permissions.xml``."""
_SPECIAL = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def adopted_documents(files: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """Return the documents of a package that another tool signed, by the names of the unsigned documents."""
    return {name.removeprefix(PREFIX): content for name, content in files.items() if name.startswith(PREFIX)}


def adopted_sources(profile: WorkspaceProfile, sources: AdoptedSources) -> Mapping[str, bytes]:
    """Return the files of a package: see :meth:`keymint.api.AdoptingPackageType.adopted_sources`."""
    domains = [_domains(sources.domains)] if sources.domains else []
    name = [f"<subject_name>{sources.subject_name.translate(_SPECIAL)}</subject_name>"] if sources.subject_name else []
    cert = (*name, validity.element(sources.validity))
    overrides = (*domains, *name, validity.element(sources.grant_validity))
    return {
        **bootstrap.package(profile.build_types),
        "identities.xml": filled_file("package/identities.adopted.xml", cert=cert, key=_key(sources.key)),
        "permissions.xml": permissions_writer.render(sources.rules, base_of(profile), overrides=overrides),
        **{f"{PREFIX}{name}": content for name, content in sources.documents.items()},
    }


def _domains(ranges: Sequence[DomainRange]) -> str:
    ids = [
        f"<id>{each.first}</id>"
        if each.first == each.last
        else f"<id_range><min>{each.first}</min><max>{each.last}</max></id_range>"
        for each in ranges
    ]
    return f"<domains>{''.join(ids)}</domains>"


def _key(key: KeySpec) -> tuple[str, ...]:
    kind = (
        f"<ec><curve>{key.curve}</curve></ec>"
        if key.algorithm == "ec"
        else f"<rsa><key_size>{key.size}</key_size></rsa>"
    )
    return (
        f"<asymmetric_type>{kind}</asymmetric_type>",
        "<encryption_algorithm>NoEncryption</encryption_algorithm>",
        "<password_env></password_env>",
    )
