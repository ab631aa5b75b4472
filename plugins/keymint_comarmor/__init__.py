# SPDX-License-Identifier: Apache-2.0
"""What policy types share whose policies are those of the ComArmor language: no plugin by itself."""
