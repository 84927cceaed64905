"""Linear systems that change at events. In reading order:

tracer                             follows a motion: the compiled loop, and what it leaves to sums of exponentials
regimes, linear                    regimes as pairs, made as they are met; complex modes where damping couples; rounding
spectrum                           eigenvalues in groups, and chains where they meet
follow                             the compiled loop from event to event; what damped stops do at one
terms, search                      what a contact sees of a segment; the search for its next event by safe steps
exponential_search                 the search where forces are polynomials or eigenvalues meet, sample by sample
motion                             what is read of a motion at any time; peaks and impulses
generator, tangent                 the flow of a regime with its derivatives; derivatives along a motion
measures                           contact records and energy; where the energy does not balance
"""
