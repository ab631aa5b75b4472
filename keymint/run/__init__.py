# SPDX-License-Identifier: Apache-2.0
"""One run of a verb: plan it, in several processes if that is faster, and carry it out.

Start at :class:`keymint.run.run.Run`.
"""
