# SPDX-License-Identifier: Apache-2.0
"""Pictures of semantic access graphs: SVG, PNG, Graphviz DOT, and a report in HTML. All of it is pure.

Start at :mod:`~keymint.drawing.labelled_graph`, what is drawn, and at :mod:`~keymint.drawing.svg`, how.
"""
