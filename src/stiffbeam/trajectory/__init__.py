"""Runs of schemes, solvers and other programs: states, impacts, energy balance."""
