# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: findings that concern several enclaves of a keystore."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import Inspection
from keymint.errors import KeymintError
from keymint.pki import distinguished_names
from keymint_ros2_dds import authority_roles as roles
from keymint_ros2_dds import subject_name_text
from keymint_ros2_dds.credentials import subject_of
from keymint_ros2_dds.enclave_layout import CERTIFICATE, has_one_authority


def check_all(inspections: Sequence[Inspection]) -> tuple[Diagnostic, ...]:
    """Return findings that concern several enclaves; codes are stable."""
    return (
        *_doubled_attributes(inspections),
        *_shared_grants(inspections),
        *_shared_authorities(inspections),
        *_different_authorities(inspections),
    )


def _tokens(name: str) -> frozenset[str]:
    """Return the tokens of a subject name that Cyclone DDS compares.

    Cyclone DDS splits both names at ``,``, ``/`` and ``|`` and requires only that every token of the identity occurs
    in the grant (``ac_check_subjects_are_equal`` in its ``access_control_utils.c``). So ``CN=/robot`` may use the grant
    of ``CN=/robot/camera``, which every peer receives in a handshake.
    """
    return frozenset(token.strip() for token in re.split(r"[,/|]", name) if token.strip())


def _shared_grants(inspections: Sequence[Inspection]) -> Iterator[Diagnostic]:
    subjects = [(inspection, name, _tokens(name)) for inspection in inspections if (name := _subject(inspection))]
    holders: dict[str, set[int]] = defaultdict(set)
    for number, (_, _, tokens) in enumerate(subjects):
        for token in tokens:
            holders[token].add(number)
    for number, (inspection, name, tokens) in enumerate(subjects):
        for other in sorted(set.intersection(*(holders[token] for token in tokens)) - {number}):
            granted = subjects[other][0].package.subject
            yield Diagnostic.warning(
                "names-confused",
                f"on Cyclone DDS the identity {name!r} can use the permissions of {granted}",
                Origin(f"{inspection.folder}/{CERTIFICATE}"),
                "give each subject_name an RDN that no other has, e.g. OU={unique}", inspection.package.subject,
            )  # fmt: skip


def _doubled_attributes(inspections: Sequence[Inspection]) -> Iterator[Diagnostic]:
    for inspection in inspections:
        name = _subject(inspection)
        kinds = [part.partition("=")[0] for part in name.split(",")]
        if len({*kinds}) < len(kinds) and (confused := subject_name_text.twice(distinguished_names.parse(name))):
            where = Origin(f"{inspection.folder}/{CERTIFICATE}")
            help_ = "let its authority issue names with each attribute once, e.g. one CN and one OU"
            yield Diagnostic.warning("names-confused", confused, where, help_, inspection.package.subject)


def _subject(inspection: Inspection) -> str:
    try:
        return distinguished_names.to_text(subject_of(inspection.files.get(CERTIFICATE, b"")))
    except KeymintError:
        return ""


def _shared_authorities(inspections: Sequence[Inspection]) -> Iterator[Diagnostic]:
    """Yield one finding for each authority that both issues identities and signs permissions."""
    reported: set[bytes] = set()
    for inspection in inspections:
        authority = inspection.chains[roles.PERMISSIONS]
        if authority and authority == inspection.chains[roles.IDENTITY] and authority not in reported:
            reported.add(authority)
            # Where enclaves have no file for a second authority, the user cannot act on it.
            one = has_one_authority(inspection.layout, inspection.package.distro)
            severity = Severity.NOTE if one else Severity.WARNING
            yield Diagnostic(
                "authority-shared", severity,
                f"the authority {inspection.package.grant.issuer!r} issues identities and signs permissions: on "
                "older releases of DDS implementations an identity can sign permissions for itself (CVE-2023-24010)",
                Origin(f"{inspection.folder}/{CERTIFICATE}"),
                "use two authorities", inspection.package.subject,
            )  # fmt: skip


def _different_authorities(inspections: Sequence[Inspection]) -> Iterator[Diagnostic]:
    """Yield a finding for each enclave with another permissions authority; Fast DDS requires one for all."""
    for inspection in inspections[1:]:
        first = inspections[0]
        if inspection.chains[roles.PERMISSIONS] != first.chains[roles.PERMISSIONS]:
            yield Diagnostic.warning(
                "authorities-differ",
                f"its permissions are signed by {inspection.package.grant.issuer!r}, those of "
                f"{first.package.subject} by {first.package.grant.issuer!r}: on Fast DDS they cannot communicate",
                Origin(inspection.folder), "sign all permissions by one authority", inspection.package.subject,
            )  # fmt: skip
