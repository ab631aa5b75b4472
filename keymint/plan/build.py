"""The stage ``build``: from source packages to unsigned documents, and a key for each subject."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from comarmor.errors import Diagnostic, Origin
from keymint.api import BuildOptions, BuildResult
from keymint.changes import Action, DocumentSize, File, FolderChange, Plan, Step, changed
from keymint.errors import KeymintError
from keymint.plan import identity_keys, key_record, lifetimes
from keymint.plan.lifetimes import Lifetime
from keymint.session import Inputs, Session
from keymint.state import Stamp, digest, digest_files

STAGE = "build"


@dataclass(frozen=True, slots=True)
class _Planned:
    """What planning one package gives; the fingerprint is that of a key that is new in its place."""

    step: Step
    stamp: Stamp | None = None
    fingerprint: str = ""
    diagnostics: Sequence[Diagnostic] = ()
    lifetimes: Sequence[Lifetime] = ()


def plan_build(
    session: Session,
    names: Sequence[str],
    options: BuildOptions,
    *,
    force: bool = False,
    renew: bool = False,
) -> Plan:
    """Plan the unsigned documents of some packages.

    Args:
        session: the workspace and its profile.
        names: names of packages that exist.
        options: options of the build types.
        force: build anew, also over documents that were edited by hand.
        renew: replace the private keys of the subjects.

    Raises:
        KeymintError: the defects of all packages together.
    """
    planned: list[_Planned] = []
    errors: list[Diagnostic] = []
    for name in names:
        try:
            planned.append(_plan_package(session, name, options, force=force, renew=renew))
        except KeymintError as error:
            errors += error.diagnostics
    if errors:
        raise KeymintError.of(errors)
    # What is said of an authority is said once, not for each of the packages below it.
    diagnostics = dict.fromkeys(said for each in planned for said in each.diagnostics)
    of_packages = {each.step.package: each.lifetimes for each in planned}
    diagnostics |= dict.fromkeys(lifetimes.findings(of_packages, session))
    stamps = {each.step.package: each.stamp for each in planned if each.stamp}
    minted = {each.step.package: each.fingerprint for each in planned if each.fingerprint}
    state = key_record.record(session.state.updated(STAGE, stamps), key_record.IDENTITIES, minted)
    return Plan(tuple(each.step for each in planned), state, tuple(diagnostics))


def is_current(session: Session, name: str, files: dict[str, bytes]) -> bool:
    """Tell whether the documents of a package were built from its sources as they are now, by whatever options."""
    stamp = session.state.stamp(STAGE, name)
    return stamp is not None and stamp.inputs == wanted_inputs(session, files)


def _about(options: BuildOptions, subject: str) -> BuildOptions:
    """Return the options without what concerns other subjects, so that it leads to no new documents of this one."""
    return replace(options, demand=tuple(each for each in options.demand if each.edge.subject == subject))


def wanted_inputs(session: Session, files: dict[str, bytes]) -> str:
    """Return the digest of what the documents of a package are built from."""
    return digest(session.profile_digest, digest_files(files), session.plugins.versions)


def _plan_package(
    session: Session,
    name: str,
    options: BuildOptions,
    *,
    force: bool,
    renew: bool,
) -> _Planned:
    folder = session.workspace.build / name
    files = session.package_files(name)
    wanted = wanted_inputs(session, files)
    options = _about(options, f"/{name}")
    asked = digest(repr(options))
    stamp = session.state.stamp(STAGE, name)
    key_path = session.workspace.identity_key(name)
    key_content = session.tree.read(key_path)
    same = stamp is not None and (stamp.inputs, stamp.context) == (wanted, asked)
    if stamp and same and key_content is not None and not force and not renew:
        there = {file: session.tree.read(folder / file) for file in stamp.outputs}
        if None not in there.values():
            edited = [file for file, content in there.items() if digest(content or b"") != stamp.outputs[file]]
            if not edited:
                step = Step(STAGE, name, Action.UNCHANGED)
            else:
                step = Step(STAGE, name, Action.KEPT, detail=_edited(edited))
            return _Planned(step, lifetimes=lifetimes.recalled(session, name, stamp))
    package = session.package(name)
    built = session.plugins.build_type(package.build_type, session.package_marker(package.name)).build(package, options)
    if not force:
        _refuse_edits(session, name, folder, built.documents)
    changes = changed(session.tree, folder, {file: File(content) for file, content in built.documents.items()})
    minted: tuple[FolderChange, ...] = ()
    fingerprint = ""
    if renew:
        change, fingerprint = identity_keys.mint(session, package, key_path)
        minted = (change,)
    elif key_content is None:
        change, fingerprint = identity_keys.restore_or_mint(session, package, key_path)
        minted = (change,)
    else:
        identity_keys.load(session, package, key_path, key_content)
    before = stamp is not None or any(session.tree.read(folder / file) is not None for file in built.documents)
    action = (Action.UPDATED if before else Action.CREATED) if changes or minted else Action.UNCHANGED
    outputs = {file: digest(content) for file, content in built.documents.items()}
    said = [*package.diagnostics, *built.diagnostics]
    sizes = _sizes(built)
    step = Step(STAGE, name, action, (*minted, *changes), ", ".join(map(_smaller, sizes)), sizes)
    own = lifetimes.lifetimes(package)
    made = Stamp(wanted, outputs, context=asked, lifetimes=lifetimes.dump(own, session.workspace))
    return _Planned(step, made, fingerprint, said, own)


def _sizes(built: BuildResult) -> tuple[DocumentSize, ...]:
    return tuple(
        DocumentSize(file, len(built.documents[file]), plain) for file, plain in sorted(built.plain_sizes.items())
    )


def _smaller(size: DocumentSize) -> str:
    if size.bytes == size.plain_bytes:
        return f"{size.file} {size.bytes:,} bytes"
    return f"{size.file} {size.bytes:,} bytes, plain {size.plain_bytes:,}"


def _edited(files: Sequence[str]) -> str:
    return f"{', '.join(files)} edited by hand; -f builds anew"


def _refuse_edits(inputs: Inputs, name: str, folder: Path, documents: Mapping[str, bytes]) -> None:
    """Refuse to overwrite a document that is neither what was built before nor what is built now."""
    for file, content in documents.items():
        there = inputs.tree.read(folder / file)
        if there is not None and there != content and not inputs.state.wrote(STAGE, name, file, there):
            raise KeymintError(
                "was edited by hand, and its sources changed as well",
                where=Origin(inputs.workspace.shown(folder / file)),
                help=f"'keymint build -f {name}' discards the edit",
                code="hand-edited",
            )
