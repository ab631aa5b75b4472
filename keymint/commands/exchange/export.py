# SPDX-License-Identifier: Apache-2.0
"""``keymint export``: a policy in the language of another tool, proven to mean the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from comarmor.text import did_you_mean
from keymint.api import LoadedPolicy, PolicyFormat, PolicyType
from keymint.command_line.named_files import deliver, read_input, replacement_refusal
from keymint.command_line.named_packages import listed_names
from keymint.command_line.named_policies import Policies
from keymint.command_line.options import PolicyOptions, force_option, policy_options
from keymint.command_line.verb import FILE, PATH, Report, Run, argument, flag, option, path_option, verb
from keymint.commands.exchange.import_policy import diagnostics_of, proofs_of
from keymint.errors import KeymintError, Origin, usage_error
from keymint.ir import SubjectRules
from keymint.names import no_subject, typed_subject

_FORMATS = "keymint.policy_formats"


@verb(dry_run=True)
def export(
    run: Run,
    policy: Path | None = argument(required=False, type=PATH),
    form: str = option("--format", metavar="NAME", required=True),
    output: Path | None = path_option("-o", kind=FILE),
    listed: Path | None = path_option("--subjects", kind=FILE),
    lossy: bool = flag(),
    force: bool = force_option,
    policy_options: PolicyOptions = policy_options,
) -> Report:
    """Write POLICY in the language of another tool, for the subjects that it names and those of --subjects.

    What that language cannot express is an error with its line. --lossy leaves out what only allows something; a DENY
    is never left out, since more would be allowed without it.

    If the other tool compiles documents for a transport, nothing is written unless they permit what the policy
    allows, for every name, as the transport's standard reads them; differences between vendors are notes. XACML is
    written without a proof.

    Options:
        form: The format: of a policy type, or xacml.
        output: Write the policy to this file [standard output].
        listed: Further subjects, one a line, for profiles with wildcards.
        lossy: Leave out ALLOW rules that the format cannot express; each is listed.
    """
    writer = _writer(run, form)
    policies = Policies(run, policy_options)
    subjects = _subjects(run, policies.load(policy), listed)
    made = writer.exported(subjects, lossy=lossy)
    diagnostics = [*made.diagnostics]
    if writer.BUILD_TYPE:
        proofs = proofs_of(run, writer, made, policies.distro)
        diagnostics += diagnostics_of(proofs, writer.TOOL)
    keep = None if force else replacement_refusal(output, "exported", "name another file", "export-exists")
    result: dict[str, Any] = {
        **deliver(run, output, made.document, keep=keep),
        "policy": None if output else made.document.decode(),
        "subjects": [each.subject for each in subjects],
    }
    return run.report(result, diagnostics, notes=True)


def _writer(run: Run, form: str) -> PolicyType | PolicyFormat:
    """Return what writes a format: a policy type that also reads it, or a plugin that only writes it.

    Raises:
        KeymintError: there is none.
    """
    formats = run.plugins.names(_FORMATS)
    if form in formats:
        return run.plugins.policy_format(form)
    known = {each.FORMAT: each for each in run.plugins.policy_types().values() if each.FORMAT}
    if form not in known:
        every = sorted({*known, *formats})
        hint = did_you_mean(form, every, f"known: {', '.join(every) or 'none'}")
        raise usage_error(f"no plugin exports the format {form!r}", hint)
    return known[form]


def _subjects(run: Run, policy: LoadedPolicy, listed: Path | None) -> list[SubjectRules]:
    """Return the rules of the subjects that the policy names, and of those in a file.

    Raises:
        KeymintError: there is no subject, or no profile applies to one.
    """
    names: dict[str, Origin | None] = dict.fromkeys(policy.subjects())
    if listed is not None:
        for name, place in listed_names(read_input(run, listed), str(listed)):
            names.setdefault(typed_subject(name), place)
    if not names:
        raise no_subject("list subjects in a file: --subjects FILE")
    found = []
    for name, where in names.items():
        rules = policy.rules(name)
        if rules is None:
            raise KeymintError(f"no profile applies to {name}", where=where, code="subject-unknown")
        found.append(rules)
    return found
