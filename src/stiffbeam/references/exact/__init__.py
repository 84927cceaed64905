"""The exact solution in float64, based on the package piecewise. In reading order:

piecewise                          compliant stops: checks, the Reference, perturbed copies for the horizon
rigid_reference, rigid_motion      rigid stops with restitution: the Reference; a motion and its Taylor series
impacting                          solver for rigid stops, from event to event
derivative, orbit                  derivatives in parameters; periodic orbits
"""
