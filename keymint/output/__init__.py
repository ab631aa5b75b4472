"""Formats that other tools read findings and test results from: SARIF and JUnit."""
