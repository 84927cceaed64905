"""The exact solution in float64, by the kernel of exact motion. In reading order:

free           a system in its free modes, as the kernel takes it
motion         solver, perturbed copies, and a motion at any time
solution       checks, the solution as a Reference, its contacts and its energy balance
tangent        derivatives along a motion, regime by regime
derivative     derivatives of a Reference
orbit          periodic orbits
"""
