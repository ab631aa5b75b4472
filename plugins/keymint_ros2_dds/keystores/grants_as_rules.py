# SPDX-License-Identifier: Apache-2.0
"""Read what signed permissions grant as rules of a policy, in which order has no meaning and DENY overrides ALLOW.

In a document the first rule that matches decides (DDS Security 1.1, 9.4.1.3). A denial that follows a rule which allows
some of the same is left out where it has no effect; elsewhere no policy can say it, and it is an error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import compress
from typing import cast

from comarmor.patterns import glob
from comarmor.patterns.expression import canonical
from comarmor.patterns.glob import EVERYTHING, Glob, matches
from comarmor.patterns.relations import covers, disjoint
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.patterns.tokens import PatternError
from comarmor.rules import Effect, Rule
from comarmor.text import quote
from comarmor.values import Data
from keymint.api import DomainRange, EnclaveFiles, FoundEnclave, GrantedRules, InstalledRights, KeystoreFiles
from keymint.errors import Diagnostic, KeymintError, Origin, require_none
from keymint.ir import SubjectRules
from keymint.pki import certificates, smime
from keymint.pki.distinguished_names import parse
from keymint_ros2_dds import subject_names
from keymint_ros2_dds.decision.semantics import STANDARD
from keymint_ros2_dds.domains import in_words, merged_domains
from keymint_ros2_dds.enclave_layout import (
    CA,
    CERTIFICATE,
    PERMISSIONS_CA,
    PERMISSIONS_P7S,
    PERMISSIONS_ROLE,
    PERMISSIONS_XML,
)
from keymint_ros2_dds.lowering.name_mapping import TOPIC_ACTIONS, TopicAction, in_ros
from keymint_ros2_dds.proving.document_lists import have_partitions
from keymint_ros2_dds.proving.enclave_governance import cuts
from keymint_ros2_dds.proving.grant_periods import grant_periods
from keymint_ros2_dds.reading import signed_permissions
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, DocumentRule, PermissionsDocument

STEPS = 4_000_000
"""Steps that finding out which denials matter may take (:mod:`comarmor.patterns.steps`)."""


def granted_rules(keystore: KeystoreFiles, enclave: FoundEnclave, distro: str) -> GrantedRules:
    """Return what the signed permissions of an enclave grant; see :meth:`keymint.api.KeystoreReader.granted`.

    Raises:
        KeymintError: the signature does not verify, the document cannot be read, or no policy can say what it grants.
    """
    path = _path(keystore, enclave, PERMISSIONS_P7S)
    authority = enclave.files.get(PERMISSIONS_CA) or _path(keystore, enclave, CA)
    where = Origin(f"{keystore.folder}/{path}")
    signed = smime.read(keystore.files[path].content, keystore.files[authority].content, where=where)
    document = signed_permissions.read(signed.content, where.file, signed.lines_before)
    place = Origin(f"{keystore.folder}/{_path(keystore, enclave, CERTIFICATE)}")
    name = subject_names.of_any(certificates.load(enclave.certificate, place).subject)
    rules, domains, findings = rules_of(document, name, enclave.subject, distro)
    return GrantedRules(
        SubjectRules(enclave.subject, rules), signed.content, where.file, signed.lines_before, name, domains, findings
    )


def installed_rights(
    enclave: EnclaveFiles, subject: str, built: Mapping[str, bytes] | None = None
) -> InstalledRights | None:
    """Return what the permissions of an enclave grant; see :meth:`keymint.api.Prover.rights`.

    Raises:
        KeymintError: the anchors do not vouch for them, they cannot be read, or no policy can say what they grant.
    """
    files, anchors, name = enclave.files, enclave.anchors, PERMISSIONS_P7S if built is None else PERMISSIONS_XML
    if name not in (files if built is None else built):
        return None
    where = Origin(f"{enclave.folder}/{name}")
    if built is None:
        signed = smime.read(files[name], anchors.authorities[PERMISSIONS_ROLE].chain, where=where)
        document = signed_permissions.read(signed.content, where.file, signed.lines_before)
        identity = certificates.load(files.get(CERTIFICATE, b""), Origin(f"{enclave.folder}/{CERTIFICATE}")).subject
    else:
        document, identity = signed_permissions.read(built[name], where.file), parse(anchors.subject_name)
    rules, domains, _ = rules_of(document, subject_names.of_any(identity), subject, anchors.distro)
    return InstalledRights(rules, domains)


def rules_of(
    document: PermissionsDocument, name: str, subject: str, distro: str
) -> tuple[tuple[Rule, ...], tuple[DomainRange, ...], tuple[Diagnostic, ...]]:
    """Return the rules of an identity in a document, the domains in which they apply, and what is left out.

    Args:
        document: the document.
        name: distinguished name of the identity, in the order of RFC 2253.
        subject: the subject.
        distro: ROS 2 distribution whose name mapping applies.

    Raises:
        KeymintError: its schema does not allow the document, or no policy can say what it grants, with ``file:line``.
    """
    require_none(document.defects)
    grant, findings = _grant(document, name, subject)
    if grant is None:
        return (), (), findings
    domains, applying = _applying(document, grant)
    steps = list(_steps(document, grant, applying))
    named = not have_partitions([grant])
    try:
        with step_limit(STEPS):
            rules = tuple(_rules(_unordered(steps, named=named), distro, named=named))
    except StepLimitError as error:
        message = f"its rules overlap in too many ways: not decided in {error.steps:,} steps"
        raise _unsayable(message, document.place(grant.line), "put denials before what is allowed") from None
    return rules, domains, findings


def _path(keystore: KeystoreFiles, enclave: FoundEnclave, name: str) -> str:
    if name not in enclave.files:
        where = Origin(f"{keystore.folder}/{enclave.facts['place']}/{name}")
        raise KeymintError("is missing", where=where, help="restore it", code="file-missing")
    return enclave.files[name]


def _grant(
    document: PermissionsDocument, name: str, subject: str
) -> tuple[DocumentGrant | None, tuple[Diagnostic, ...]]:
    """Return the grant of an identity, and warnings about those that are never in force.

    Raises:
        KeymintError: there are several, each in its time.
    """
    own = STANDARD.grants(document, name)
    eras = tuple(grant_periods(document, name, STANDARD))
    if len(eras) > 1:
        message = (
            f"{quote(name)} has another grant from {eras[1].begin:%Y-%m-%d} on, and rules of a policy have no time"
        )
        raise _unsayable(message, document.place(eras[1].grant.line), "sign a document with one grant")
    grant = eras[0].grant if eras else None
    message, help_ = f"this grant of {quote(name)} is never in force, and is not learned", "remove it from the document"
    findings = [
        Diagnostic.warning("learn-grant", message, document.place(each.line), help_, subject)
        for each in own
        if each is not grant
    ]
    if not own:
        message = f"no grant is for {quote(name)}, so the enclave is permitted nothing"
        help_ = "sign a document for this name"
        findings.append(Diagnostic.warning("learn-grant", message, Origin(document.file), help_, subject))
    return grant, tuple(findings)


def _applying(
    document: PermissionsDocument, grant: DocumentGrant
) -> tuple[tuple[DomainRange, ...], tuple[DocumentRule, ...]]:
    """Return the domains in which a grant permits anything, and the rules that apply in all of these.

    Raises:
        KeymintError: rules that matter apply in some of them only.
    """
    groups: dict[tuple[bool, ...], list[DomainRange]] = {}
    for domains in cuts(each for rule in grant.rules for each in rule.domains):
        applies = tuple(STANDARD.applies(rule, domains.first) for rule in grant.rules)
        if grant.allows or any(rule.allows and rule.criteria for rule in compress(grant.rules, applies)):
            groups.setdefault(applies, []).append(domains)
    if len(groups) > 1:
        first, second = list(groups)[:2]
        rule = next(rule for rule, a, b in zip(grant.rules, first, second, strict=True) if a is not b)
        message = (
            f"permits something else in {in_words(groups[first])} than in {in_words(groups[second])}, because of this "
            "rule; rules of a policy hold in all its domains"
        )
        raise _unsayable(message, document.place(rule.line), "learn from one document for each domain")
    for applies, ranges in groups.items():
        return tuple(merged_domains(ranges)), tuple(compress(grant.rules, applies))
    return (), ()


class _Step(Data):
    """A topic expression of a document: what it decides, and for what.

    Attributes:
        effect: what it decides.
        action: about which action.
        topic: its pattern.
        partitions: expressions; none: the default partition of an allowed topic, and every one of a denied topic.
        where: place of its element.
    """

    effect: Effect
    action: TopicAction
    topic: Glob
    partitions: tuple[Glob, ...]
    where: Origin


def _steps(document: PermissionsDocument, grant: DocumentGrant, rules: Sequence[DocumentRule]) -> Iterator[_Step]:
    """Yield the steps of a grant in order; its default is the last one.

    Raises:
        KeymintError: a policy cannot say it, or it is not defined what it matches.
    """
    for rule in rules:
        effect = Effect.ALLOW if rule.allows else Effect.DENY
        for criteria in rule.criteria:
            where = document.place(criteria.line)
            if criteria.tags is not None:
                raise _unsayable("is about data tags, which no policy has", where, "remove them")
            try:
                partitions = tuple(glob.parse(each) for each in criteria.partitions or ())
                topics = [glob.parse(each) for each in criteria.topics]
            except PatternError as error:
                raise KeymintError.of(
                    Diagnostic.error("expression", each.message, where, each.help) for each in error.diagnostics
                ) from None
            if effect is Effect.ALLOW and partitions == ((),):
                partitions = ()
            for topic in topics:
                if topic and not glob.is_empty(topic):
                    yield _Step(effect, cast("TopicAction", criteria.action), topic, partitions, where)
    if grant.allows:
        for action in TOPIC_ACTIONS:
            yield _Step(Effect.ALLOW, action, EVERYTHING, (EVERYTHING,), document.place(grant.line))


def _unordered(steps: Sequence[_Step], *, named: bool) -> Iterator[_Step]:
    """Yield the steps that matter.

    Args:
        steps: the steps of a document, in order.
        named: nothing is allowed outside of the default partition.

    Raises:
        KeymintError: a denial would deny what an earlier step allows.
    """
    allowed: list[_Step] = []
    for number, step in enumerate(steps):
        if step.effect is Effect.ALLOW:
            allowed.append(step)
        elif before := [each for each in allowed if _overlap(each, step)]:
            later = (each for each in steps[number:] if each.effect is Effect.ALLOW)
            is_covered = any(_covers(each, step, named=named) for each in before)
            if not is_covered and any(_overlap(each, step) for each in later):
                first = before[0]
                what = f"denies to {step.action} {quote(canonical(step.topic))}, but line {first.where.line} before it"
                message = f"{what} allows {quote(canonical(first.topic))}; in a policy every DENY overrides every ALLOW"
                raise _unsayable(message, step.where, "write out the names that are allowed")
            continue  # all of it is allowed before, or nothing that follows allows any of it
        yield step


def _unsayable(message: str, where: Origin, help_: str) -> KeymintError:
    """Return the error that no policy can say what a document grants."""
    return KeymintError(message, where=where, help=help_, code="learn-unsayable")


def _overlap(allowing: _Step, denying: _Step) -> bool:
    if allowing.action != denying.action:
        return False
    own = allowing.partitions or ((),)
    shared = not denying.partitions or any(not disjoint(a, b) for a in own for b in denying.partitions)
    return shared and not disjoint(allowing.topic, denying.topic)


def _covers(allowing: _Step, denying: _Step, *, named: bool) -> bool:
    own = allowing.partitions or ((),)
    wide = own if named else denying.partitions or (EVERYTHING,)
    return covers(allowing.topic, denying.topic) and all(any(covers(a, b) for a in own) for b in wide)


def _rules(steps: Iterator[_Step], distro: str, *, named: bool) -> Iterator[Rule]:
    """Yield a rule for each name: on ROS names where the topics of a default partition say so, else on DDS topics.

    Args:
        steps: the steps.
        distro: ROS 2 distribution whose name mapping applies.
        named: nothing is allowed outside of the default partition, so that denials of others say nothing.
    """
    places: dict[Effect, dict[tuple[TopicAction, Glob], Origin]] = {effect: {} for effect in Effect}
    raw: dict[_Step, None] = {}
    for step in steps:
        if not step.partitions or (named and any(matches(each, "") for each in step.partitions)):
            places[step.effect].setdefault((step.action, step.topic), step.where)
        else:
            raw[step] = None
    for effect, patterns in places.items():
        names: Mapping[tuple[str, str, Glob], tuple[TopicAction, Glob]] = in_ros(patterns, distro)
        for (kind, permission, name), source in names.items():
            yield Rule(effect, kind, (permission,), (canonical(name),), (), False, patterns[source])
    for step in raw:
        partitions = tuple(map(canonical, step.partitions))
        yield Rule(step.effect, "topic", (str(step.action),), (canonical(step.topic),), partitions, False, step.where)
