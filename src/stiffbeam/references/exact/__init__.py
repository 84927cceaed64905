"""The exact solution in float64: linear between switches, which are searched for. In the order of reading:

piecewise                                what is called: refusals, the tracer, the Reference
undamped, undamped_tracer, following     at most one contact and no damping: modes, three regimes, all compiled
exponential, exponential_tracer          damping or several contacts: sums of complex exponentials
terms, switching                         what a contact sees of a piece, and the search for its next switch by leaps
exponential_search                       the search where forces are polynomials
touching, oscillation                    what both rest on: safe steps along a gap, one driven mode
pressing                                 peaks and impulses of a piece without damping
exact_measures, audit                    contact records, peaks and energy; where the energy does not balance
tangent                                  growth of perturbations along the solution
rigid_reference, impacting, taylor       rigid stops with restitution: the Reference, impact by impact, one stretch
rigid                                    the same for restitution 1 by closed forms, the end of kappa -> infinity
"""
