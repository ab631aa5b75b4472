# SPDX-License-Identifier: Apache-2.0
"""What is to be renewed, and when: the certificates, permissions and revocation lists of the installed enclaves.

An enclave works until the first of its documents ends. What ends with its authority cannot be renewed before the
authority is, so it is the authority that is due then.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime

from cryptography import x509

from comarmor.values import Data, replace
from keymint.api import Issuance, Validity
from keymint.authority.authority_files import in_order, with_issuers
from keymint.errors import Defects
from keymint.life.revocation_lists_in_force import list_of
from keymint.life.terms import DEFAULT, Term, Threshold, recorded_terms
from keymint.pki import certificate_forms, certificates, periods
from keymint.workspace.installed_enclaves import INSTALLED, enclave_names, installed_certificate
from keymint.workspace.session import Session, once

CERTIFICATE, PERMISSIONS, LIST = "certificate", "permissions", "revocation list"


def first_due(terms: Iterable[Term], threshold: Threshold = DEFAULT) -> Term | None:
    """Return the term of an enclave that is due first, without what ends with its authority."""
    own = [each for each in terms if not each.is_cut]
    return min(own, key=lambda each: each.renew_after(threshold), default=None)


@once
def authority_ends(session: Session) -> Mapping[str, datetime]:
    """Return the end of the certificate of each authority whose certificate is here, UTC, issuers first."""
    return {name: certificate.not_valid_after_utc for name, certificate in _authorities_here(session).items()}


@once
def _authorities_here(session: Session) -> Mapping[str, x509.Certificate]:
    """Return the certificate of each authority that has one here, issuers first."""
    names = [authority.name for authority in in_order(session.profile.authorities)]
    contents = {name: session.tree.read(session.workspace.authority_certificate(name)) for name in names}
    return {name: certificates.load_first(content) for name, content in contents.items() if content}


def enclave_terms(session: Session, name: str, *, as_recorded: bool = False) -> tuple[Term, ...]:
    """Return what of an installed enclave ends; nothing if it is not installed, or its certificate cannot be read.

    The dates are those of the certificate in the enclave, and of the permissions as they were when they were signed.

    Args:
        session: the workspace and its profile.
        name: the package.
        as_recorded: the enclave is as it was installed, so that its certificate need not be read.

    Raises:
        KeymintError: there is no record of the installation, and the package has defects.
    """
    certificate = None if as_recorded else installed_certificate(session, name)
    if certificate is None and not as_recorded:
        return ()
    ends = authority_ends(session)
    terms: list[Term] = []
    for each in recorded_terms(session, name, session.state.stamp(INSTALLED, name)):
        if each.what != CERTIFICATE:
            terms.append(replace(each, what=PERMISSIONS))
            continue
        if certificate is not None:
            first, last = certificates.period(certificate)
        else:  # cut to its issuer's, and in whole seconds
            issued = certificate_forms.validity_within(
                Validity(each.first, each.last), _authorities_here(session)[each.issuer]
            )
            first, last = issued.not_before, issued.not_after
        terms.append(replace(each, first=first, last=last))
        if listed := list_of(session, each.issuer):
            terms.append(replace(each, what=LIST, first=listed.this_update, last=listed.next_update))
    in_force = (each.until(ends.get(each.issuer)) for each in terms)
    return tuple(sorted(in_force, key=lambda each: each.what))


def authority_renewals(session: Session, terms: Iterable[Term]) -> Mapping[str, datetime]:
    """Return from when on each authority cuts what it signs for some enclaves, so that it is due."""
    ends = authority_ends(session)
    due: dict[str, datetime] = {}
    for term in terms:
        if term.what != LIST and term.issuer in ends:
            moment = session.now if term.is_cut else ends[term.issuer] - term.length
            moment = max(moment, _matters_from(session, term, DEFAULT))
            due[term.issuer] = min(due.get(term.issuer, moment), moment)
    return due


def _matters_from(session: Session, term: Term, threshold: Threshold) -> datetime:
    """Return from when on it matters that an authority shortens a document.

    One that lasts half as long as the authority's certificate, or longer, ends near it in any case, as in a keystore of
    ``ros2 security``, where both last ten years. It has time until the document is due itself.
    """
    authority = _authorities_here(session)[term.issuer]
    length = authority.not_valid_after_utc - authority.not_valid_before_utc
    return term.renew_after(threshold) if 2 * term.length >= length else term.first


class Due(Data):
    """An enclave to renew, or the list of an authority to issue again, and why.

    Attributes:
        name: name of the package or of the authority.
        why: the document that is due first; None if a user asked for it.
        after: from when on it is due; None in the same case.
    """

    name: str
    why: Term | None = None
    after: datetime | None = None


class AuthorityDue(Data):
    """An authority that a person must renew: what it signs ends with it, or it ends soon itself.

    Attributes:
        name: its name.
        end: end of its certificate, UTC.
        packages: packages whose documents it cuts now, or would cut if they were renewed.
        issuers: the authorities above it that end no later, so that they must be renewed before.
    """

    name: str
    end: datetime
    packages: tuple[str, ...]
    issuers: tuple[str, ...]


class Schedule(Data):
    """What is due now, and what is next.

    Attributes:
        enclaves: the enclaves to renew.
        lists: the revocation lists to issue again, by authority.
        authorities: the authorities that a person must renew.
        following: the enclave that is due next, after these; None if there is none.
    """

    enclaves: tuple[Due, ...]
    lists: tuple[Due, ...]
    authorities: tuple[AuthorityDue, ...]
    following: Due | None


def schedule(session: Session, terms: Mapping[str, Iterable[Term]], threshold: Threshold) -> Schedule:
    """Return what is due.

    Args:
        session: the workspace and its profile.
        terms: what of the enclaves to look at ends, by package.
        threshold: when something is due.
    """
    enclaves: list[Due] = []
    due_lists: dict[str, Due] = {}
    later: list[Due] = []
    for name, of_enclave in terms.items():
        for term in of_enclave:
            after = term.renew_after(threshold)
            if term.what == LIST and not term.is_cut and after <= session.now:
                due_lists.setdefault(term.issuer, Due(term.issuer, term, after))
        if first := first_due((term for term in of_enclave if term.what != LIST), threshold):
            moment = first.renew_after(threshold)
            (enclaves if moment <= session.now else later).append(Due(name, first, moment))
    following = min(later, key=lambda each: (each.after or session.now, each.name), default=None)
    authorities = tuple(_authorities(session, terms, threshold))
    return Schedule(tuple(enclaves), tuple(due_lists.values()), authorities, following)


def _authorities(session: Session, terms: Mapping[str, Iterable[Term]], threshold: Threshold) -> Iterator[AuthorityDue]:
    """Yield the authorities that cut what they sign.

    That is where the threshold for an authority comes from: with ten years of validity, and a year for what it signs,
    it is due a year before its end.
    """
    ends = authority_ends(session)
    issuers = {each.name: each.certificate.issuer for each in session.profile.authorities}
    cut: dict[str, dict[str, None]] = {}
    used: set[str] = set()
    for name, of_enclave in terms.items():
        for term in of_enclave:
            used.add(term.issuer)
            end = ends.get(term.issuer)
            if term.what == LIST or end is None or session.now < _matters_from(session, term, threshold):
                continue
            if term.is_cut or periods.begin(session.now, term.length) + term.length > end:
                cut.setdefault(term.issuer, {})[name] = None
    for name, end in ends.items():
        soon = name in used and threshold.left is not None and end - session.now <= threshold.left
        if name in cut or soon:
            _, *above = with_issuers(name, issuers)
            before = tuple(issuer for issuer in above if issuer in ends and ends[issuer] <= end)
            yield AuthorityDue(name, end, tuple(cut.get(name, ())), before)


def installed_terms(session: Session, names: Iterable[str]) -> Mapping[str, tuple[Term, ...]]:
    """Return what ends of those of some packages that are installed, by package.

    Raises:
        KeymintError: packages have defects, and there is no record of their installation; with all defects.
    """
    there = frozenset(enclave_names(session))
    found: dict[str, tuple[Term, ...]] = {}
    defects = Defects()
    for name in names:
        with defects:
            if name in there and (terms := enclave_terms(session, name)):
                found[name] = terms
    defects.require_none()
    return found


def renewal_issuance(session: Session, name: str) -> Issuance:
    """Return what an authority decides about a package that it renews now: its period begins now, the rest stays.

    Raises:
        KeymintError: the package has defects.
    """
    package, before = session.package(name), session.issuance(name)
    validities = [each for each in (package.identity.validity, package.grant.validity) if each]
    begin = periods.begin(session.now, min(each.not_after - each.not_before for each in validities))
    # What began today already begins then; what has yet to begin was written while a clock was wrong.
    kept = all(begin <= each.not_before <= session.now for each in validities)
    return before if kept else replace(before, renewed=begin)


def list_end(session: Session, due: Due) -> datetime | None:
    """Return nextUpdate of a list that is issued again: it is as long as before; None for the end of the authority."""
    if due.why is None:
        return None
    length = due.why.length
    end = session.now - periods.back(length) + length
    last = authority_ends(session).get(due.name)
    return None if last is None or end >= last else end
