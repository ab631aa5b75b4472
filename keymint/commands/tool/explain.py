# SPDX-License-Identifier: Apache-2.0
"""``keymint explain``: what the code of an error or a finding means."""

from __future__ import annotations

import textwrap
from functools import partial

from comarmor.text import did_you_mean, quote
from keymint.command_line.verb import Report, Run, argument, verb
from keymint.errors import usage_error
from keymint.output.explanations import explanations

PARTS = ("cause", "effect", "remedy")
_WRAPPER = partial(textwrap.TextWrapper, 80, subsequent_indent=" " * 10, break_on_hyphens=False)


@verb(workspace=False)
def explain(run: Run, codes: tuple[str, ...] = argument(nargs=-1, metavar="[CODE]...")) -> Report:
    """Explain CODE, the word in brackets at the end of each message: cause, effect and remedy.

    Without a CODE, list all codes. It needs neither a workspace nor a network.
    """
    known = explanations()
    wanted = [each.strip("[]").lower() for each in codes] or [*known]
    for code in wanted:
        if code not in known:
            listed = "'keymint explain' lists the codes; a code of a plugin is explained by its authors"
            raise usage_error(f"no code {quote(code)}", did_you_mean(code, known, listed), "code-unknown")
    if not codes:
        rows = [{"code": code, "cause": texts["cause"].partition(". ")[0].rstrip(".")} for code, texts in known.items()]
        run.console.table({"CODE": "code", "CAUSE": "cause"}, rows)
    for number, code in enumerate(wanted if codes else ()):
        run.console.lines(("", code) if number else (code,))
        for part in PARTS:
            run.console.lines(_WRAPPER(initial_indent=f"  {part + ':':8}").wrap(known[code][part]))
    return run.report({"codes": [{"code": code, **known[code]} for code in wanted]})
