# SPDX-License-Identifier: Apache-2.0
"""The compiler: from the lowered rules of a subject to the rules of the grant in its permissions document.

The passes in order: ``plans`` and ``partitions`` make decision lists, ``rules`` puts these into an order that every
vendor reads in the same way, ``gathering`` and ``priority`` rewrite them. ``compile`` runs the passes.
:mod:`keymint_ros2_dds.emit.emission` proves the result and chooses among its forms.
"""
