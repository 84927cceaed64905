"""Sampled impacts, step by step: chi_k != 0 and chi_k != chi_{k-1}, chi the contact state of u_k."""

from __future__ import annotations

# A tally (..., 8) is what one contact has seen so far.
SIDE, TOUCHING, PEAK, IMPULSE, ROW, SINCE, LAST = range(7)
# The steps up to SINCE are passed over; SIDE is followed from the start. LAST is |F| at the last step, of laws that are
# not linear.
# An impact is one row of a list of events; ROW is the row of the one that is open, or -1. A contact that is there at
# t = 0 has a row too, with TIME = AT_START.
CONTACT, TIME, STOP, IMPACT_PEAK, IMPACT_IMPULSE, END = range(6)
AT_START = -1.0
