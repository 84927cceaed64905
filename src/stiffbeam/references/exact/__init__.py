"""The exact solution in float64, a client of the room piecewise. In the order of reading:

piecewise                          what is called: refusals, the Reference, perturbed copies
tangent                            growth of perturbations along the solution
rigid_reference, impacting, taylor rigid stops with restitution: the Reference, impact by impact, one segment
rigid                              the same for restitution 1 by closed forms, the end of kappa -> infinity
"""
