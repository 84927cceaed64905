"""Time loops of the schemes on a system, in reading order:

    integrate, ensemble    what is called: one run, many members
    choice                 choice of the fastest march, and of the rule for the contact forces of a node
    direct_march           any scheme on any system, step by step with factorised matrices
    block_march            the same in blocks of K steps
    probe                  the matrices of a scheme's step, in modes or for all unknowns, from unit inputs
    propagator             powers of that step, arranged as the arrays of a block
    kernels                the compiled loops over blocks
    replay                 states and energies of every step of a block march, computed on demand
    rigid_march            any scheme against rigid stops

A run is a function of its arguments: run again, it has the same bits.
"""
