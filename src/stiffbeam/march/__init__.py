"""Time loops of the schemes on a system, in reading order:

    integrate, ensemble    what is called: one run, many members
    choice                 which march pays, and how its nodes find their forces
    direct_march           any scheme on any system, step by step with factorised matrices
    block_march            the same in blocks of K steps
    probe                  a scheme's own step in modes or all unknowns, taken once with unit inputs
    propagator             that step raised to powers and arranged as the arrays of a block
    kernels                the loops over them, compiled
    replay                 what blocks pass over, when it is asked for: states and energies
    rigid_march            any scheme against rigid stops

A run is a function of its arguments: made again, it has the same bits.
"""
