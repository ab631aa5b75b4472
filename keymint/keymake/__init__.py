"""Compiler passes over patterns and names that know no transport."""
