# SPDX-License-Identifier: Apache-2.0
"""``keymint authority export``: an authority's certificate, and on request its private key, to files."""

from __future__ import annotations

from pathlib import Path

from keymint.authority import authority_files
from keymint.authority.authorities import authority_named, only_in_token
from keymint.command_line.named_files import deliver, write_outputs
from keymint.command_line.options import authority_argument
from keymint.command_line.verb import FILE, Report, Run, flag, path_option, verb
from keymint.errors import Diagnostic, KeymintError, Origin, usage_error


@verb(of="authority")
def authority_export(
    run: Run,
    name: str = authority_argument,
    output: Path | None = path_option("-o", kind=FILE),
    chain: bool = flag(),
    key_file: Path | None = path_option("--with-key", kind=FILE),
) -> Report:
    """Write the certificate of an authority as PEM; never its private key, unless --with-key asks for it.

    Options:
        output: Write the certificate here [standard output].
        chain: Add the certificates above it, up to the self-signed one.
        key_file: Also write its private key here (mode 0600). Whoever has it can make any robot do anything.
    """
    session = run.session()
    files = authority_files.read_files(session, authority_named(session, name))
    if files.certificate is None or files.content is None:
        message = f"the authority {name!r} has no certificate"
        help_ = "'keymint install' makes it"
        raise KeymintError(message, where=files.certificate_file, help=help_, code="authority-missing")
    if key_file and output and (run.setting.cwd / key_file).resolve() == (run.setting.cwd / output).resolve():
        raise usage_error("the certificate and the private key would be written into one file", "name two files")
    issuers = {each.name: each.certificate.issuer for each in session.profile.authorities}
    names = authority_files.with_issuers(name, issuers) if chain else (name,)
    content = b"".join(session.tree.read(session.workspace.authority_certificate(each)) or b"" for each in names)
    findings: list[Diagnostic] = []
    written: list[str] = []
    if key_file:
        # As it is stored: encrypted if it has a password.
        if files.authority.certificate.key.uri:
            raise only_in_token(files.authority, "it returns none")
        if files.key is None:
            raise authority_files.key_elsewhere(files.name, files.key_file, "export it where it is")
        written = write_outputs(run, key_file, files.key, secret=True)
        message = f"is the private key of the authority {name!r}: whoever has it can make any robot do anything"
        help_ = "move it to where it belongs, and delete it here"
        findings.append(Diagnostic.warning("key-exported", message, Origin(str(key_file)), help_))
    own = deliver(run, output, content)
    result = {"certificate": content.decode("ascii"), **own, "written": [*written, *own["written"]]}
    return run.report(result, findings, workspace=session.workspace)
