"""Time loops of the schemes on a system, in reading order:

    integrate              what is called: one run, many members
    treatment              treatments of contact: implicit, extrapolated, conserving
    block_march            any scheme on any system in blocks of K steps
    propagator             the matrices of a scheme's step, in modes or for all unknowns, and of a block of steps
    rigid_march            a scheme with an impact law against rigid stops

A run is a function of its arguments: run again, it has the same bits.
"""
