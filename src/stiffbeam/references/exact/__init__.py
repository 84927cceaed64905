"""The exact solution in float64, by the kernel of exact motion. In reading order:

free           a system in its free modes, as the kernel takes it
motion         solver, perturbed copies, and a motion at any time
contacts       records of contacts and the energy balance of a motion
solution       checks, and the solution as a Reference
tangent        derivatives along a motion, regime by regime
derivative     derivatives of a Reference
orbit          periodic orbits
"""
