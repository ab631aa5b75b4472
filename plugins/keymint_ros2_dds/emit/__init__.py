# SPDX-License-Identifier: Apache-2.0
"""Documents of subjects of one kind: the engine makes the first one, and renaming its topics makes the others.

``structure`` says which DDS names a subject puts into a kind, and compares subjects; ``members`` decides who is
renamed, and who goes to the engine. ADR 0026 has the lemma on which this stands, and why each of its conditions is
needed.
"""
