"""Beams, matrices, contact laws and functions of time, and the semi-discrete System that they give."""
