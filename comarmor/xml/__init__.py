"""XML for every format: reading with limits, validation with file:line, and paths sandboxed in a folder."""
