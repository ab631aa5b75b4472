# SPDX-License-Identifier: Apache-2.0
"""XML for every format: reading with limits, validation with file:line, and paths sandboxed in a folder."""
