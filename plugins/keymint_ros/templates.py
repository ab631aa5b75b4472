# SPDX-License-Identifier: Apache-2.0
"""Files from the templates of this plugin: ``$name`` is a value, and a line that is ``$name`` alone a list of lines.

The templates are those of :class:`string.Template`: a larger library takes a tenth of the time of a short run to load.
"""

from __future__ import annotations

from string import Template

from comarmor.data import locate

_SPECIAL = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&#34;", "'": "&#39;"})


def filled_file(path: str, /, **values: object) -> bytes:
    """Return the file of a template.

    Args:
        path: path of the template in ``templates/keymint_ros``.
        values: by name: lines of XML as a tuple, which get the indentation of the line that names them; or a text, that
            is escaped.

    Raises:
        KeyError: the template names a value that is not given.
    """
    lines = {name: value for name, value in values.items() if isinstance(value, tuple)}
    texts = {name: escape_xml(str(value)) for name, value in values.items() if name not in lines}
    template = (locate("keymint_ros", "templates") / path).read_text("utf-8")
    result: list[str] = []
    for line in template.splitlines(keepends=True):
        named = line.strip().removeprefix("$")
        if named in lines:
            indentation = line[: len(line) - len(line.lstrip())]
            result += [f"{indentation}{each}\n" for each in lines[named]]
        else:
            result.append(Template(line).substitute(texts))
    return "".join(result).encode()


def escape_xml(text: str) -> str:
    """Return a text with references for what has a meaning in XML, also within an attribute."""
    return text.translate(_SPECIAL)
