"""Measures of a run, each quantity defined once."""
