"""Motions of linear systems that change at events, in closed form. In reading order:

tracer                             a whole motion: by the compiled loop, or segment by segment as sums of exponentials
regimes, linear                    regimes with real modes, built at first entry; with complex modes, if damping couples
spectrum                           eigenvalues in groups, and Jordan chains of equal ones
follow                             the compiled loop from event to event, and the events of damped stops
terms, search                      the gap in a segment as a sum of terms; the search for its next zero by safe steps
exponential_search                 the same search for complex exponentials and for records, sample by sample
motion                             states and positions at any time; peaks and impulses
generator, tangent                 the flow of a regime and its derivatives; derivatives along a motion
measures                           contact records, energy, and the check that the energy balances
"""
