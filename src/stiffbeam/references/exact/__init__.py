"""The exact solution in float64: linear between switches, which are searched for. In the order of reading:

piecewise                                what is called: refusals, the tracer, the Reference
undamped, undamped_tracer                at most one contact and no damping: three regimes, all compiled
undamped_regimes, following, pieces      these regimes; from switch to switch; what is read of the pieces
exponential, exponential_tracer          damping or several contacts: sums of complex exponentials
exponential_regime, spectrum, chains     one regime of them; its eigenvalues in groups; where eigenvalues meet
terms, switching                         what a contact sees of a piece, and the search for its next switch by leaps
exponential_search                       the search where forces are polynomials or eigenvalues meet
touching, oscillation                    what both rest on: safe steps along a gap, one driven mode
pressing                                 peaks and impulses of a piece without damping
exact_measures, audit                    contact records, peaks and energy; where the energy does not balance
tangent                                  growth of perturbations along the solution
rigid_reference, impacting, taylor       rigid stops with restitution: the Reference, impact by impact, one stretch
rigid                                    the same for restitution 1 by closed forms, the end of kappa -> infinity
"""
