"""Loops in C: march, law of contact, exact motion, right-hand side; and the NumPy functions that call them."""
