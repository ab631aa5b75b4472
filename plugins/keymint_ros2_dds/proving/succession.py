# SPDX-License-Identifier: Apache-2.0
"""Rights that the earlier permissions of an enclave give, and its new ones do not, while both fit its certificate.

A signed document stays good until it expires: its holder may present the earlier one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice, product

from comarmor.patterns.decision_lists import DecisionList, SearchBudget, Unknown, Witness
from comarmor.patterns.proofs import escapes
from comarmor.patterns.tokens import PatternError
from keymint.api import OutlivingRights
from keymint.errors import KeymintError
from keymint.pki import certificates, smime
from keymint_ros2_dds import subject_name_text
from keymint_ros2_dds.decision import OMG, read
from keymint_ros2_dds.enclave_layout import CERTIFICATE, PERMISSIONS_P7S
from keymint_ros2_dds.lowering.dds_topics import DDS_TOPICS
from keymint_ros2_dds.proving import octets, permission_lists
from keymint_ros2_dds.proving.enclave_governance import ACTIONS, cuts
from keymint_ros2_dds.proving.governance_lists import NOTHING
from keymint_ros2_dds.proving.grant_periods import GrantPeriod, grant_periods
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant

_STATES = 50_000
_OF_ARDENT = frozenset(topic.prefix for topics in DDS_TOPICS.values() for topic in topics if topic.prefix)
_SEMANTICS = OMG.semantics


def outliving(before: Mapping[str, bytes], after: Mapping[str, bytes]) -> OutlivingRights | None:
    """Return what the earlier files of an enclave permit and the new ones do not; see :class:`keymint.api.Succession`.

    The documents are compared over all names, as the standard reads them (OMG DDS-SECURITY 1.1, 9.4.1.3).
    """
    old, new = (files.get(PERMISSIONS_P7S, b"") for files in (before, after))
    if smime.signed_content(old) == smime.signed_content(new):
        return None
    earlier = _eras(before, after[CERTIFICATE])
    if not earlier:
        return None
    ends = max(each.end for each in earlier), certificates.load(after[CERTIFICATE]).not_valid_after_utc
    example = next(_lost(earlier, _eras(after, after[CERTIFICATE])), "")
    return OutlivingRights(example, min(ends)) if example else None


def changed_rights(before: Mapping[str, bytes], after: Mapping[str, bytes]) -> str:
    """Return what only one of two documents permits; see :meth:`keymint.api.Succession.changed_rights`."""
    earlier, later = (_eras(files, files[CERTIFICATE]) for files in (before, after))
    lost = [f"only the former ones permit to {each}" for each in islice(_lost(earlier, later), 1)]
    return "; ".join([*lost, *(f"only the new ones to {each}" for each in islice(_lost(later, earlier), 1))])


def _eras(files: Mapping[str, bytes], certificate: bytes) -> tuple[GrantPeriod, ...]:
    """Return the grants that an enclave's files have for a certificate."""
    content = smime.signed_content(files.get(PERMISSIONS_P7S, b""))
    name = subject_name_text.render(certificates.load(certificate).subject)
    return tuple(grant_periods(read(content, PERMISSIONS_P7S), name, _SEMANTICS))


def distro_of(paths: Iterable[str], content: Callable[[str], bytes | None]) -> str:
    """Return ``ardent`` if documents have its partitions; see :meth:`keymint.api.InstalledDistro.distro_of`.

    Only Ardent maps the namespace of a name to a partition; see :mod:`keymint_ros2_dds.lowering.ardent_names`.
    """
    for path in paths:
        with suppress(KeymintError):
            found = content(path) if path.endswith(f"/{PERMISSIONS_P7S}") else None
            grants = read(smime.signed_content(found), PERMISSIONS_P7S).grants if found else ()
            criteria = (one for grant in grants for rule in grant.rules for one in rule.criteria)
            if any(name.partition("/")[0] in _OF_ARDENT for one in criteria for name in one.partitions or ()):
                return "ardent"
    return ""


def _lost(before: Sequence[GrantPeriod], after: Sequence[GrantPeriod]) -> Iterator[str]:
    """Yield an example for each action and domain in which a right is lost, or may be."""
    earlier, later = ([each.grant for each in eras] for eras in (before, after))
    grants = (*earlier, *later)
    pairs = permission_lists.have_partitions(grants)
    universe = octets.universe(pairs=pairs)
    ranges = cuts(each for grant in grants for rule in grant.rules for each in rule.domains)
    for domains, action in product(ranges, ACTIONS):
        where = f"in domain {domains.first}"
        try:
            denying = [one for each in _lists(later, domains.first, action, pairs=pairs) for one in each] or [NOTHING]
            for permitting, each in product(_lists(earlier, domains.first, action, pairs=pairs), denying):
                found = escapes(permitting, each, universe, SearchBudget(_STATES))
                if isinstance(found, Witness):
                    word = octets.in_text(found.word.rpartition(octets.SEPARATOR)[2])
                    yield f"{action} {word!r} {where}"
                elif isinstance(found, Unknown):
                    yield f"{action} something {where} (unknown: {found.reason})"
        except PatternError as error:
            yield f"{action} something {where} (unknown: {error})"


def _lists(grants: Sequence[DocumentGrant], domain: int, action: str, *, pairs: bool) -> list[tuple[DecisionList, ...]]:
    return [permission_lists.of_grant(each, domain, action, _SEMANTICS, pairs=pairs) for each in grants]
