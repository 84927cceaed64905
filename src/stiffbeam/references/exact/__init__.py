"""The exact solution in float64, based on the package piecewise. In reading order:

piecewise                          compliant stops: refusals, the Reference, perturbed copies
rigid_reference, rigid_motion      rigid stops with restitution: the Reference; a motion and its series
impacting                          its solver, from event to event
derivative, orbit                  derivatives in parameters; periodic orbits and their distance from a graze
continuation                       branches of orbits
"""
