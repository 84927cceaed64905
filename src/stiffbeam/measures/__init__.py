"""Measures of a run: errors, phase lag, matched impacts, rates, amplification. Each is defined once."""
