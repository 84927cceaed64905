"""Marching a scheme over a system, in the order of reading:

    integrate, ensemble    what is called: one run, many members
    choice                 which of the marches pays
    direct_march           any scheme on any system, step by step with factorised matrices
    block_march            the same in blocks of K steps
    coordinates            modes, where these decouple, or all unknowns together
    probe, powers, build   a scheme's own step, taken once with unit inputs, raised to powers, arranged as a block
    propagator, layout     what comes out: a map and its arrays
    kernels                the loops over them, compiled; blocks_numpy and blocks_jax do the same
    replay, free_blocks    what blocks pass over, when it is asked for: states and energies

A run is a function of its arguments: made again, it has the same bits.
"""
