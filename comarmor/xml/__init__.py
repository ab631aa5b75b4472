"""XML, for every format: bounded reading, schemas with file:line, and includes that stay in their folder."""
