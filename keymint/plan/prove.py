"""The stage ``prove``: claims about installed enclaves. It writes nothing but the record of what was proven.

An enclave whose every claim was proven is not looked at again until its files, the policy on it, or the tool change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

from keymint import __version__
from keymint.api import Claim, LoadedPolicy, Obligation, Package, Proof, Prover
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.ir import SubjectRules
from keymint.plan.inputs import Inputs, LoadedProfile, Sources
from keymint.state import Stamp, State, digest, digest_files

STAGE = "prove"


@dataclass(frozen=True, slots=True)
class Effort:
    """How much may be spent.

    Attributes:
        states: states that a question may visit.
        deadline: called for each enclave; returns what tells whether to go on.
    """

    states: int
    deadline: Callable[[], Callable[[], bool]]


@dataclass(frozen=True, slots=True)
class Proven:
    """What is known of one enclave.

    Attributes:
        subject: its subject.
        claims: by model, action and domains; none if the enclave could not be read.
        counted: how many claims there are, also where they are known from the record only.
        remembered: every claim was proven before, and nothing changed.
        diagnostics: what could not be read.
    """

    subject: str
    claims: tuple[Claim, ...]
    counted: int
    remembered: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, slots=True)
class Findings:
    """What is known of all enclaves, the record to keep, and what the claims take for granted, by model."""

    enclaves: tuple[Proven, ...]
    state: State
    assumptions: Mapping[str, Sequence[str]]


def prove(
    inputs: Inputs,
    loaded: LoadedProfile,
    names: Sequence[str],
    sources: Sources,
    policy: LoadedPolicy,
    effort: Effort,
    on_enclave: Callable[[str], None],
) -> Findings:
    """Prove, or refute, the claims about the enclaves of some packages.

    Args:
        inputs: the workspace.
        loaded: its profile.
        names: names of packages.
        sources: the packages' files.
        policy: what the enclaves are held against.
        effort: how much may be spent.
        on_enclave: called with each name when it is done.

    Raises:
        KeymintError: a package has defects.
    """
    found: list[Proven] = []
    stamps: dict[str, Stamp] = {}
    assumptions: dict[str, Sequence[str]] = {}
    for name in names:
        package = sources.load(inputs, loaded, name, sources.files(inputs, name))
        build_type = inputs.plugins.build_type(package.build_type, inputs.package_marker(name))
        if not hasattr(build_type, "prove"):
            message = f"the build type {package.build_type} proves nothing"
            said = Diagnostic("not-proven", Severity.ERROR, message, inputs.package_marker(name), "", package.subject)
            found.append(Proven(package.subject, (), 0, diagnostics=(said,)))
            continue
        prover = cast("Prover", build_type)
        assumptions.update(prover.assumptions())
        folder = inputs.workspace.enclaves(loaded.profile.layout) / name
        rules = policy.rules(package.subject) or SubjectRules(package.subject, ())
        files = inputs.tree.files(folder)
        wanted = _wanted(inputs, package, rules, files)
        stamp = inputs.state.stamp(STAGE, name)
        if stamp is not None and stamp.inputs == wanted:
            found.append(Proven(package.subject, (), len(stamp.outputs), remembered=True))
        else:
            shown = inputs.workspace.shown(folder)
            obligation = Obligation(
                rules, package.distro, package.permissions.domains, files, shown, effort.states, effort.deadline()
            )
            found.append(_prove(prover, obligation, name))
            if not found[-1].diagnostics and all(claim.proof is Proof.PROVEN for claim in found[-1].claims):
                stamps[name] = Stamp(wanted, {_key(claim): str(claim.proof) for claim in found[-1].claims})
        on_enclave(name)
    refuted = {one.subject.removeprefix("/") for one in found if not one.remembered} - stamps.keys()
    return Findings(tuple(found), inputs.state.updated(STAGE, stamps, refuted), assumptions)


def _prove(prover: Prover, obligation: Obligation, name: str) -> Proven:
    subject = obligation.rules.subject
    if not obligation.files:
        message, help_ = f"the enclave {subject} is not installed", f"run 'keymint install {name}'"
        said = Diagnostic("enclave-missing", Severity.ERROR, message, Origin(obligation.folder), help_, subject)
        return Proven(subject, (), 0, diagnostics=(said,))
    try:
        claims = tuple(prover.prove(obligation))
    except KeymintError as error:
        said_all = (Diagnostic(d.code, d.severity, d.message, d.where, d.help, subject) for d in error.diagnostics)
        return Proven(subject, (), 0, diagnostics=tuple(said_all))
    return Proven(subject, claims, len(claims))


def _key(claim: Claim) -> str:
    domains = ",".join(f"{each.first}-{each.last}" for each in claim.domains)
    return f"{claim.model} {claim.action} {domains}"


def _wanted(inputs: Inputs, package: Package, rules: SubjectRules, files: Mapping[str, bytes]) -> str:
    """Return the digest of all that a proof depends on; private keys are no part of it."""
    public = {name: content for name, content in files.items() if not name.endswith("key.pem")}
    return digest(
        digest_files(public),
        repr(rules),
        repr(package.permissions.domains),
        package.distro,
        inputs.plugins.versions,
        __version__,
    )
