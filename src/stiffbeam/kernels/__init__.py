"""Loops in C: the march, the law of contact, exact motion and the right-hand side; and the NumPy functions that call them."""
