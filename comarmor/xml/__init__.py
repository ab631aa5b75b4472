# SPDX-License-Identifier: Apache-2.0
"""XML for every format: reading with limits, validation with file:line, and files that documents include.

Start at :mod:`~comarmor.xml.reader`. Included files lie in the document's own folder (``sandboxed_paths``) or are
shipped by ROS packages (``package_folders``).
"""
