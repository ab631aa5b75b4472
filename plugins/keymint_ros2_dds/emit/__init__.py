# SPDX-License-Identifier: Apache-2.0
"""From the rules of a package to the bytes of its permissions; open ``kind_members.emit_by_kind`` first, the door.

It asks the engine in ``emission`` for the first subject of a kind, and renames the topics of that document for the
others. ADR 0026 has the lemma on which this stands, and why each of its conditions is needed.
"""
